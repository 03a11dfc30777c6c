"""Commands that start Chrome but not Ray, and their error messages on a machine without Chrome."""

from __future__ import annotations

from pathlib import Path

import pytest

from giirl_core.wire.messages import read_episodes
from tests.end_to_end.commands import run_giirl

pytestmark = pytest.mark.chrome


def test_demos_make_writes_demonstrations_that_demos_stats_can_read(tmp_path: Path) -> None:
    out = tmp_path / "made.giirl"
    status, output, leftover = run_giirl(
        "demos", "make", "--out", out, "--task", "click-test-2", "--task", "enter-text", "--per-task", "5"
    )
    assert (status, leftover) == (0, []), output
    episodes = read_episodes(out)
    assert sorted(episode.trajectory.task for episode in episodes) == ["click-test-2"] * 5 + ["enter-text"] * 5
    assert all(episode.outcome.success for episode in episodes)
    status, output, leftover = run_giirl("demos", "stats", out)
    assert (status, leftover) == (0, []), output
    for task in ("click-test-2", "enter-text"):
        line = next(line for line in output.splitlines() if f" {task} " in line)
        assert line.replace("│", " ").split()[1:3] == ["5", "5"]


def test_doctor_finds_all_dependencies_on_this_machine() -> None:
    status, output, _ = run_giirl("doctor")
    assert status == 0, output
    assert "MISSING" not in output


@pytest.mark.parametrize("runtime", ["serial", "local"])
def test_without_chrome_a_run_ends_at_once_with_one_line_that_says_how_to_install_it(
    runtime: str, tmp_path: Path
) -> None:
    status, output, leftover = run_giirl(
        "train", f"runtime={runtime}", f"run={tmp_path / 'run'}", env={"GIIRL_CHROME": "/nonexistent"}
    )
    assert status == 1
    lines = [line for line in output.splitlines() if line.startswith("giirl:")]
    assert len(lines) == 1, output
    assert lines[0] == output.splitlines()[-1]
    assert "GIIRL_CHROME=/nonexistent is not a program" in lines[0]
    assert "apt-get install chromium chromium-driver" in lines[0]
    assert "Traceback" not in output
    assert leftover == []
