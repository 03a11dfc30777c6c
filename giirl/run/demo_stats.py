"""Statistics of demonstrations, task by task."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from rich.table import Table

from giirl_core.types import Episode


def verbs(episodes: Sequence[Episode]) -> dict[str, int]:
    """The number of actions with each verb, the most frequent first."""
    counts = Counter(action.verb.name.lower() for episode in episodes for action in episode.trajectory.actions)
    return dict(counts.most_common())


def stats_table(title: str, episodes: Sequence[Episode]) -> Table:
    """For each task: episodes, successes, goals, steps, elements and verbs."""
    table = Table(title=title)
    for name in ("task", "episodes", "succeeded", "goals", "median steps", "median elements", "verbs"):
        table.add_column(name, justify="left" if name in ("task", "verbs") else "right", no_wrap=name == "task")
    for task in sorted({episode.trajectory.task for episode in episodes}):
        own = [episode for episode in episodes if episode.trajectory.task == task]
        elements = [len(page) for episode in own for page in episode.trajectory.pages]
        table.add_row(
            task,
            str(len(own)),
            str(sum(episode.outcome.success for episode in own)),
            str(len({episode.trajectory.goal.utterance for episode in own})),
            f"{np.median([len(episode.trajectory) for episode in own]):.0f}",
            f"{np.median(elements):.0f}",
            ", ".join(f"{verb} {count}" for verb, count in verbs(own).items()),
        )
    return table
