"""The limit on open files: raised to what the actors need, or refused in one line."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from giirl_core.processes import open_files
from giirl_core.processes.open_files import affordable_actors, files_for, raise_open_files


def run_limited(soft: int, hard: int, *command: str) -> subprocess.CompletedProcess[str]:
    """Run Python with these limits on open files."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))

    return subprocess.run(
        [sys.executable, *command], preexec_fn=limit, capture_output=True, text=True, timeout=100, check=False
    )


def test_the_limit_is_raised_to_what_the_actors_need_and_never_lowered() -> None:
    code = (
        "import resource; from giirl_core.processes.open_files import raise_open_files\n"
        "for actors in (100, 10): raise_open_files(actors); print(resource.getrlimit(resource.RLIMIT_NOFILE))"
    )
    done = run_limited(256, 4096, "-c", code)
    assert done.stdout.splitlines() == [f"({files_for(100)}, 4096)"] * 2, done.stderr


def test_more_actors_than_the_limit_allows_are_refused_before_anything_is_done(tmp_path: Path) -> None:
    run = tmp_path / "run"
    arguments = ("browser=fake", "net.vectors=hashed", "actors.count=400", f"run={run}")
    done = run_limited(256, 1024, "-m", "giirl", "train", *arguments)
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 1
    assert last == (
        "giirl: this process may open 1024 files, and 400 actors need 2112: wanted ulimit -n 2112, "
        "or at most 128 actors (actors.count)"
    )
    assert not run.exists()


def test_as_many_actors_as_are_affordable_are_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_files, "open_files_limit", lambda: 1024)
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    monkeypatch.setattr(resource, "setrlimit", lambda *limits: None)
    raise_open_files(affordable_actors(1024))
    with pytest.raises(ValueError, match="129 actors need 1028"):
        raise_open_files(affordable_actors(1024) + 1)
    assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] == soft
