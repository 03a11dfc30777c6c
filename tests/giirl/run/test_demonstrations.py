"""Where the demonstrations of a run come from."""

from __future__ import annotations

from pathlib import Path

import pytest

from giirl.run.demonstrations import collect_demonstrations, make
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.wire.messages import write_episodes
from tests.giirl.small import config

BUTTON, TEST = "click-button", "click-test"


def test_scripted_experts_demonstrate_the_tasks_that_are_named_and_the_file_the_others(tmp_path: Path) -> None:
    metrics, display = Metrics(), Display()
    recorded = make(config(tmp_path, f'tasks=["{BUTTON}"]'), metrics, display)
    write_episodes(tmp_path / "demos.giirl", recorded)
    settings = (f'tasks=["{BUTTON}", "{TEST}"]', "demos.source=file", f"demos.path={tmp_path / 'demos.giirl'}")
    with pytest.raises(ValueError, match=f"no successful demonstration of '{TEST}'"):
        collect_demonstrations(config(tmp_path, *settings), metrics, display)
    _, found = collect_demonstrations(config(tmp_path, *settings, f'demos.scripted_tasks=["{TEST}"]'), metrics, display)
    assert [episode.trajectory.task for episode in found] == [BUTTON] * 4 + [TEST] * 4


def test_a_scripted_task_without_an_expert_is_an_error(tmp_path: Path) -> None:
    settings = config(tmp_path, f'tasks=["{BUTTON}"]', 'demos.scripted_tasks=["click-buton"]')
    with pytest.raises(ValueError, match="click-buton"):
        collect_demonstrations(settings, Metrics(), Display())
