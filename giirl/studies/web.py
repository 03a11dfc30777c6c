"""The studies of the web chapter: the variants for each table and figure of the thesis, and for further questions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from giirl.studies.runner import Variant
from giirl.studies.web_variants import (
    BARE_CLONING,
    BASELINES,
    CLONING,
    COMPARED,
    DEFAULTS,
    FIFTY_TWO,
    FIFTY_TWO_FEW,
    FIFTY_TWO_SETTINGS,
    FOLLOWERS,
    FROM_CLONE,
    GIIRL,
    LONG_CLONING,
    NETS,
    SCRIPTED_TASKS,
    budget_variants,
    family_variants,
    tuning_variants,
)

RECORDINGS = "2017-10-16_second-turk"


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """The variants of a study and the settings that all share. `pages` per task and seed are used for evaluation."""

    title: str
    variants: tuple[Variant, ...]
    settings: tuple[str, ...] = ()
    pages: int = 200
    curves: bool = False  # draw success against environment steps
    evaluates_reward: bool = False  # measure whether each learned reward depends on the goal
    tuning: bool = False  # used to choose settings, on the seeds for tuning
    compared: tuple[Variant, Variant] | None = None  # of fifty-two tasks: GIIRL and cloning, beside published results

    def only(self, names: Sequence[str]) -> tuple[Variant, ...]:
        """The variants of these names, all without names. ValueError if one is unknown or needs another's reward."""
        if unknown := set(names) - {variant.name for variant in self.variants}:
            wanted = ", ".join(repr(variant.name) for variant in self.variants)
            raise ValueError(f"variant {min(unknown)!r}: wanted one of {wanted}")
        chosen = tuple(variant for variant in self.variants if variant.name in names or not names)
        for variant in chosen:
            if variant.reward_of and variant.reward_of not in {other.name for other in chosen}:
                raise ValueError(f"variant {variant.name!r} trains on the reward of {variant.reward_of!r}: wanted both")
        return chosen


STUDIES = {
    "table-4.1": Study(
        title="Success on the thesis's four web tasks", variants=(GIIRL,), pages=1000, evaluates_reward=True
    ),
    "figure-4.7": Study(title="True success while a reward is learned", variants=(GIIRL,), curves=True),
    "figure-4.8": Study(title="GIIRL and cloning as they train", variants=(GIIRL, CLONING, BARE_CLONING), curves=True),
    "meaning": Study(title="Whether the reward reads the instruction", variants=(GIIRL,), evaluates_reward=True),
    "defaults": Study(title="The effect of each default", variants=DEFAULTS, evaluates_reward=True, tuning=True),
    "baselines": Study(title="GIIRL and the baselines, on the same nets", variants=BASELINES, curves=True),
    "tuning": Study(title="Tuning of the baselines", variants=tuning_variants(), tuning=True),
    "budgets": Study(title="Few demonstrations, and noisy ones", variants=budget_variants()),
    "frozen": Study(title="Fresh policies on the frozen reward", variants=FOLLOWERS, curves=True),
    "held-out": Study(
        title="Goals held out of training",
        variants=(GIIRL, CLONING, Variant(name="fresh policy, frozen reward", reward_of="giirl")),
        settings=('tasks=["click-button", "click-link", "enter-text"]', "held_out_goals=0.25"),
        pages=1000,
        evaluates_reward=True,
    ),
    "families": Study(
        title="Transfer of a reward within a family of tasks",
        variants=family_variants(),
        settings=("step_limit=20", "net.adjacent_elements=true"),  # up to twelve check boxes with labels next to them
    ),
    "fifty-two": Study(
        title="Fifty-two tasks, one policy and one reward",
        variants=FIFTY_TWO,
        settings=FIFTY_TWO_SETTINGS,
        compared=COMPARED,
    ),
    "fifty-two-few": Study(
        title="Fifty-two tasks from few demonstrations",
        variants=FIFTY_TWO_FEW,
        settings=FIFTY_TWO_SETTINGS,
    ),
    "scripted-tasks": Study(
        title="All tasks with a scripted expert that the nets can follow, one policy and one reward",
        variants=(
            Variant(name="giirl from the clone", changes=(*FROM_CLONE, f"rollout_batch={len(SCRIPTED_TASKS)}")),
            LONG_CLONING,
        ),
        settings=("demos.source=scripted", f"tasks={json.dumps(SCRIPTED_TASKS)}", "step_limit=25"),
        pages=50,
    ),
    "nets": Study(title="Ablations of the nets, in policy and reward alike", variants=NETS, evaluates_reward=True),
}


def base_settings(study: Study, demos: Path | None) -> tuple[str, ...]:
    """The settings of all runs: at most 32 demonstrations per task, human recordings if a folder is given."""
    source: tuple[str, ...] = ("demos.source=scripted",)
    if demos is not None:
        source = ("demos.source=recordings", f"demos.path={demos}", f'demos.collections=["{RECORDINGS}"]')
    pages = (f"evaluate.episodes={study.pages}", f"evaluate.random_episodes={study.pages}")
    return (*source, "demos.per_task=32", *pages, *study.settings)
