"""The studies of the web chapter: the variants for each table and figure of the thesis, and for further questions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from browser_farm.experts import EXPERTS
from giirl.studies import fifty_two
from giirl.studies.runner import Variant

RECORDINGS = "2017-10-16_second-turk"
BUDGETS = (1, 2, 4, 8, 16, 32)
NOISE_FRACTIONS = (0.1, 0.3)

GIIRL = Variant(name="giirl")
CLONING = Variant(name="cloning", changes=("algorithm=cloning",))
TRUE_REWARD = Variant(name="true reward", changes=("algorithm=true_reward", "policy.entropy=0.006"))
Q_LEARNING = Variant(name="Q-learning", changes=("algorithm=q_learning", "soft_q.temperature=0.03"))
WGE = Variant(name="WGE", changes=("algorithm=wge", "policy.entropy=0.006"))
BARE_CLONING = Variant(  # no renaming or jitter, four times as long, constant rate: this shows overfitting
    name="cloning, nothing renamed, 1,200 updates",
    changes=(
        "algorithm=cloning",
        "cloning.rename_prob=0",
        "cloning.position_jitter=0",
        "cloning.learning_rate=1e-3",
        "cloning.final_lr_fraction=1",
        "cloning.updates=1",
        "iterations=1200",
    ),
)
PLAIN = (  # Algorithm 1 of the thesis; also how GAIL trains policy and discriminator
    "discriminator.rollouts=1",
    "discriminator.replay=0",
    "discriminator.policy_on_expert_states=0",
    "discriminator.random_actions=0",
    "discriminator.wrong_goal=0",
    "discriminator.rename_prob=0",
    "policy.sampled_actions=0",
)
AIRL = (  # its reward assumes alpha = 1, and its D is correct only for actions of the current policy
    "discriminator.form=airl",
    "discriminator.rollouts=0.5",
    "discriminator.replay=0",
    "discriminator.random_actions=0",
    "discriminator.wrong_goal=0",
    "discriminator.clip=10",
    "policy.entropy=1",
    "policy.final_entropy_fraction=1",
)
AGILE = (  # a classifier of final steps
    "discriminator.replay=1",
    "discriminator.train_on=final_steps",
    "discriminator.reward=goal",
    "discriminator.discard_top_fraction=0.25",
)
BASELINES = (
    GIIRL,
    CLONING,
    Variant(name="plain Algorithm 1", changes=PLAIN),
    Variant(name="GAIL", changes=(*PLAIN, "discriminator.reward=gail", "policy.entropy=0.03")),
    Variant(name="giirl, GAIL's reward form", changes=("discriminator.reward=gail",)),
    Variant(name="AGILE", changes=(*PLAIN, *AGILE, "policy.entropy=0.006")),
    Variant(name="SQIL", changes=("algorithm=sqil", "soft_q.temperature=0.003")),
    Variant(name="IQ-Learn", changes=("algorithm=iq_learn", "soft_q.temperature=0.3")),
    TRUE_REWARD,
    Q_LEARNING,
    WGE,
)
TUNED = (  # variant, setting, and the values to try on tuning seeds
    ("giirl", "policy.entropy", (0.15, 0.03)),
    ("plain Algorithm 1", "policy.entropy", (0.15, 0.03, 0.006)),
    ("GAIL", "policy.entropy", (0.15, 0.03, 0.006)),
    ("AGILE", "policy.entropy", (0.15, 0.03, 0.006)),
    ("SQIL", "soft_q.temperature", (0.03, 0.01, 0.003)),
    ("IQ-Learn", "soft_q.temperature", (1.0, 0.3, 0.1, 0.03)),
    ("true reward", "policy.entropy", (0.15, 0.03, 0.006)),
    ("Q-learning", "soft_q.temperature", (0.1, 0.03, 0.01)),
    ("WGE", "policy.entropy", (0.03, 0.006)),
)
NETS = (
    GIIRL,
    Variant(name="bag of words", changes=("net.word_order=false",)),
    Variant(name="hashed words instead of GloVe", changes=("net.vectors=hashed",)),
    Variant(name="no goal overlap", changes=("net.goal_overlap=false",)),
    Variant(name="no element attention", changes=("net.element_attention=false",)),
    Variant(name="AIRL's form", changes=AIRL),
    Variant(name="slower as the policy improves", changes=("discriminator.lr_schedule=accuracy",)),
    Variant(name="gradient penalty 1", changes=("discriminator.gradient_penalty=1",)),
)
DEFAULTS = (  # one change at a time
    GIIRL,
    Variant(name="plain Algorithm 1", changes=PLAIN),
    Variant(
        name="without the policy's actions on experts' pages", changes=("discriminator.policy_on_expert_states=0",)
    ),
    Variant(name="without random actions", changes=("discriminator.random_actions=0",)),
    Variant(name="without wrong goals", changes=("discriminator.wrong_goal=0",)),
    Variant(name="without renaming", changes=("discriminator.rename_prob=0",)),
    Variant(name="without replay", changes=("discriminator.replay=0",)),
    Variant(name="with a gradient penalty of 1", changes=("discriminator.gradient_penalty=1",)),
    Variant(name="no sampled actions", changes=("policy.sampled_actions=0",)),
    Variant(
        name="learning rates that do not fall",
        changes=("discriminator.final_lr_fraction=1", "policy.final_lr_fraction=1"),
    ),
    CLONING,
    Variant(name="started by 200 updates of cloning", changes=("policy.bc_warmup_updates=200",)),
)
FOLLOWERS = (
    GIIRL,
    CLONING,
    Variant(name="fresh policy, frozen reward", reward_of="giirl"),
    TRUE_REWARD,
)


def _with_budget(variant: Variant, budget: int) -> Variant:
    """The variant with at most `budget` demonstrations of each task."""
    return Variant(name=f"{variant.name}, {budget}", changes=(*variant.changes, f"demos.per_task={budget}"))


FROM_CLONE = (
    "policy.bc_warmup_updates=1200",
    "cloning.batch=32",
    "policy.prior=clone",
    "policy.frozen_iterations=30",
    "policy.learning_rate=3e-4",
    "policy.cloning_updates=1",
    "discriminator.rollouts=0",
    "discriminator.replay=0",
    "iterations=120",
)
GIIRL_FROM_CLONE = Variant(name="giirl from the clone", changes=(*FROM_CLONE, "rollout_batch=52"))
LONG_CLONING = Variant(  # as many updates as the clone has that the others start from
    name=CLONING.name, changes=(*CLONING.changes, "iterations=60", "cloning.updates=20", "cloning.batch=32")
)
START_ALONE = ("iterations=1", "policy.frozen_iterations=1", "policy.cloning_updates=0")
COMPARED = (GIIRL_FROM_CLONE, LONG_CLONING)
FIFTY_TWO = (
    *COMPARED,
    Variant(name="true reward from the clone", changes=(*GIIRL_FROM_CLONE.changes, *TRUE_REWARD.changes)),
    Variant(name="the clone it starts from", changes=(*GIIRL_FROM_CLONE.changes, *START_ALONE)),
    Variant(name="blind replay", changes=(*CLONING.changes, "iterations=1", "evaluate.agent=replay")),
    Variant(name="giirl from nothing"),
)
FIFTY_TWO_FEW = tuple(_with_budget(variant, budget) for budget in (4, 8, 16) for variant in COMPARED)
FIFTY_TWO_SETTINGS = (
    f"tasks={json.dumps(fifty_two.TASKS)}",
    f"demos.scripted_tasks={json.dumps(fifty_two.SCRIPTED)}",
    "step_limit=25",
    "evaluate.random_episodes=50",
)
UNREADABLE = (  # what their experts type is neither in the instruction nor the text of an element
    "find-word",
    "scroll-text",
    "simple-algebra",
    "simple-arithmetic",
    "terminal",
    "text-transform",
)
SCRIPTED_TASKS = tuple(sorted(set(EXPERTS) - set(UNREADABLE)))


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


def _budgets() -> tuple[Variant, ...]:
    few = [_with_budget(variant, budget) for budget in BUDGETS for variant in (GIIRL, CLONING)]
    noisy = [
        Variant(name=f"{variant.name}, {share:.0%} noise", changes=(*variant.changes, f"demos.noise_fraction={share}"))
        for share in NOISE_FRACTIONS
        for variant in (GIIRL, CLONING)
    ]
    uninformed = Variant(  # noise is random actions, which a discriminator with random negatives recognises
        name=f"giirl without random actions, {NOISE_FRACTIONS[-1]:.0%} noise",
        changes=("discriminator.random_actions=0", f"demos.noise_fraction={NOISE_FRACTIONS[-1]}"),
    )
    return (*few, *noisy, uninformed)


def _tuning() -> tuple[Variant, ...]:
    """Entropy weights are in nats of reward, so rewards of another scale need other weights."""
    known = {variant.name: variant for variant in BASELINES}
    tuned = [
        Variant(name=f"{name}, {key} {value}", changes=(*known[name].changes, f"{key}={value}"))
        for name, key, values in TUNED
        for value in values
    ]
    noisy = (*CLONING.changes, f"demos.noise_fraction={NOISE_FRACTIONS[-1]}")  # a constant learning rate may hurt here
    cloned = [
        Variant(
            name=f"cloning, {NOISE_FRACTIONS[-1]:.0%} noise, cloning.final_lr_fraction {value}",
            changes=(*noisy, f"cloning.final_lr_fraction={value}"),
        )
        for value in (1.0, 0.1)
    ]
    return (*tuned, *cloned)


def _families() -> tuple[Variant, ...]:
    """Transfer within families of tasks: of policies as they are, and of the reward with a fresh policy."""
    transfers = {
        "click-button": ("click-link",),
        "click-checkboxes": ("click-checkboxes-large", "click-checkboxes-soft", "click-checkboxes-transfer"),
    }
    variants: list[Variant] = []
    for source, targets in transfers.items():
        here = (f'tasks=["{source}"]',)
        learned = Variant(name=f"giirl on {source}", changes=here, transfer_tasks=targets)
        cloned = Variant(name=f"cloning on {source}", changes=(*here, *CLONING.changes), transfer_tasks=targets)
        variants += [learned, cloned]
        for target in targets:
            there = (f'tasks=["{target}"]',)
            variants.append(
                Variant(name=f"its reward, a fresh policy on {target}", changes=there, reward_of=learned.name)
            )
    return tuple(variants)


STUDIES = {
    "table-4.1": Study(
        title="Success on the thesis's four web tasks", variants=(GIIRL,), pages=1000, evaluates_reward=True
    ),
    "figure-4.7": Study(title="True success while a reward is learned", variants=(GIIRL,), curves=True),
    "figure-4.8": Study(title="GIIRL and cloning as they train", variants=(GIIRL, CLONING, BARE_CLONING), curves=True),
    "meaning": Study(title="Whether the reward reads the instruction", variants=(GIIRL,), evaluates_reward=True),
    "defaults": Study(title="The effect of each default", variants=DEFAULTS, evaluates_reward=True, tuning=True),
    "baselines": Study(title="GIIRL and the baselines, on the same nets", variants=BASELINES, curves=True),
    "tuning": Study(title="Tuning of the baselines", variants=_tuning(), tuning=True),
    "budgets": Study(title="Few demonstrations, and noisy ones", variants=_budgets()),
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
        variants=_families(),
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
