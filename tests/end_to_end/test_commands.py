"""The commands that start Chrome but no Ray, and what they say on a machine without Chrome."""

from __future__ import annotations

from pathlib import Path

import pytest

from giirl_core.wire.messages import read_episodes
from tests.end_to_end.commands import giirl

pytestmark = pytest.mark.chrome


def test_made_demonstrations_are_written_and_can_be_looked_at(tmp_path: Path) -> None:
    out = tmp_path / "made.giirl"
    status, said, left = giirl(
        "demos", "make", "--out", out, "--task", "click-test-2", "--task", "enter-text", "--per-task", "5"
    )
    assert (status, left) == (0, []), said
    episodes = read_episodes(out)
    assert sorted(episode.trajectory.task for episode in episodes) == ["click-test-2"] * 5 + ["enter-text"] * 5
    assert all(episode.outcome.success for episode in episodes)
    status, said, left = giirl("demos", "stats", out)
    assert (status, left) == (0, []), said
    for task in ("click-test-2", "enter-text"):
        line = next(line for line in said.splitlines() if f" {task} " in line)
        assert line.replace("│", " ").split()[1:3] == ["5", "5"]


def test_the_doctor_finds_everything_on_this_machine() -> None:
    status, said, _ = giirl("doctor")
    assert status == 0, said
    assert "MISSING" not in said


@pytest.mark.parametrize("runtime", ["serial", "local"])
def test_without_chrome_a_run_ends_at_once_with_one_line_that_says_how_to_get_it(runtime: str, tmp_path: Path) -> None:
    status, said, left = giirl(
        "train", f"runtime={runtime}", f"run={tmp_path / 'run'}", env={"GIIRL_CHROME": "/nonexistent"}
    )
    assert status == 1
    lines = [line for line in said.splitlines() if line.startswith("giirl:")]
    assert len(lines) == 1, said
    assert lines[0] == said.splitlines()[-1]
    assert "GIIRL_CHROME=/nonexistent is no program" in lines[0]
    assert "apt-get install chromium chromium-driver" in lines[0]
    assert "Traceback" not in said
    assert left == []
