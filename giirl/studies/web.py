"""The thesis's web chapter as studies: what is run for each table and figure, and for the questions beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from giirl.studies.runner import Variant

RECORDINGS = "2017-10-16_second-turk"
BUDGETS = (1, 2, 4, 8, 16, 32)
NOISE_FRACTIONS = (0.1, 0.3)

GIIRL = Variant(name="giirl")
CLONING = Variant(name="cloning", changes=("algorithm=cloning",))
TRUE_REWARD = Variant(name="true reward", changes=("algorithm=true_reward", "policy.entropy=0.006"))
BARE_CLONING = Variant(  # same words and places, four times as long, at one rate: where it overfits, this shows it
    name="cloning, nothing renamed, 1,200 updates",
    changes=(
        "algorithm=cloning",
        "cloning.rename_prob=0",
        "cloning.position_jitter=0",
        "cloning.final_lr_fraction=1",
        "iterations=1200",
    ),
)
PLAIN = (  # Algorithm 1 as the thesis has it, and GAIL's way to play against a discriminator
    "discriminator.rollouts=1",
    "discriminator.replay=0",
    "discriminator.policy_on_expert_states=0",
    "discriminator.random_actions=0",
    "discriminator.wrong_goal=0",
    "discriminator.rename_prob=0",
    "policy.sampled_actions=0",
)
AIRL = (  # its reward is made for alpha = 1, and its D is right for what the policy does today and for nothing else
    "discriminator.form=airl",
    "discriminator.rollouts=0.5",
    "discriminator.replay=0",
    "discriminator.random_actions=0",
    "discriminator.wrong_goal=0",
    "discriminator.clip=10",
    "policy.entropy=1",
    "policy.final_entropy=1",
)
AGILE = (  # a classifier of how episodes end
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
)
TUNED = (  # what each was tried with, on tuning seeds
    ("giirl", "policy.entropy", (0.15, 0.03)),
    ("plain Algorithm 1", "policy.entropy", (0.15, 0.03, 0.006)),
    ("GAIL", "policy.entropy", (0.15, 0.03, 0.006)),
    ("AGILE", "policy.entropy", (0.15, 0.03, 0.006)),
    ("SQIL", "soft_q.temperature", (0.03, 0.01, 0.003)),
    ("IQ-Learn", "soft_q.temperature", (1.0, 0.3, 0.1, 0.03)),
    ("true reward", "policy.entropy", (0.15, 0.03, 0.006)),
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
DEFAULTS = (  # one thing changed at a time
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """What is run, for whom; `pages` are the fresh ones a task and seed that each policy is measured on."""

    title: str
    variants: tuple[Variant, ...]
    settings: tuple[str, ...] = ()
    pages: int = 200
    curves: bool = False  # whether success against environment steps is drawn
    evaluates_reward: bool = False  # whether each learned reward is asked for other goals than the page's own
    tuning: bool = False  # whether settings are chosen by it, so that its seeds are those for tuning


def _budgets() -> tuple[Variant, ...]:
    few = [
        Variant(name=f"{variant.name}, {budget}", changes=(*variant.changes, f"demos.per_task={budget}"))
        for budget in BUDGETS
        for variant in (GIIRL, CLONING)
    ]
    spoiled = [
        Variant(name=f"{variant.name}, {share:.0%} noise", changes=(*variant.changes, f"demos.noise_fraction={share}"))
        for share in NOISE_FRACTIONS
        for variant in (GIIRL, CLONING)
    ]
    uninformed = Variant(  # spoilers act by chance, which a discriminator that has seen chance knows
        name=f"giirl without random actions, {NOISE_FRACTIONS[-1]:.0%} noise",
        changes=("discriminator.random_actions=0", f"demos.noise_fraction={NOISE_FRACTIONS[-1]}"),
    )
    return (*few, *spoiled, uninformed)


def _tuning() -> tuple[Variant, ...]:
    """Entropy weights of policies are in nats of reward: rewards of another size want other ones."""
    known = {variant.name: variant for variant in BASELINES}
    tried = [
        Variant(name=f"{name}, {key} {value}", changes=(*known[name].changes, f"{key}={value}"))
        for name, key, values in TUNED
        for value in values
    ]
    spoiled = (
        *CLONING.changes,
        f"demos.noise_fraction={NOISE_FRACTIONS[-1]}",
    )  # where a rate that stays high might hurt
    cloned = [
        Variant(
            name=f"cloning, {NOISE_FRACTIONS[-1]:.0%} noise, cloning.final_lr_fraction {value}",
            changes=(*spoiled, f"cloning.final_lr_fraction={value}"),
        )
        for value in (1.0, 0.1)
    ]
    return (*tried, *cloned)


def _families() -> tuple[Variant, ...]:
    """What is learned on one task of a family, taken to others: policies as they are, and the reward by itself."""
    moves = {
        "click-button": ("click-link",),
        "click-checkboxes": ("click-checkboxes-large", "click-checkboxes-soft", "click-checkboxes-transfer"),
    }
    variants: list[Variant] = []
    for source, targets in moves.items():
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
    "defaults": Study(title="What the defaults are worth", variants=DEFAULTS, evaluates_reward=True, tuning=True),
    "baselines": Study(title="What GIIRL is compared with, on the same nets", variants=BASELINES, curves=True),
    "tuning": Study(title="What the baselines were tried with", variants=_tuning(), tuning=True),
    "budgets": Study(title="Few demonstrations, and spoiled ones", variants=_budgets()),
    "frozen": Study(title="Fresh policies on the frozen reward", variants=FOLLOWERS, curves=True),
    "held-out": Study(
        title="Goals that training never saw",
        variants=(GIIRL, CLONING, Variant(name="fresh policy, frozen reward", reward_of="giirl")),
        settings=('tasks=["click-button", "click-link", "enter-text"]', "held_out_goals=0.25"),
        pages=1000,
        evaluates_reward=True,
    ),
    "families": Study(
        title="A reward moved within a family of tasks",
        variants=_families(),
        settings=(
            "step_limit=20",
            "net.adjacent_elements=true",
        ),  # twelve boxes to tick, whose labels stand beside them
    ),
    "nets": Study(
        title="What each part of the nets is worth, in policy and reward alike", variants=NETS, evaluates_reward=True
    ),
}


def base_settings(study: Study, demos: Path | None) -> tuple[str, ...]:
    """Settings of all its runs: people's recordings from a folder, at most 32 a task, or else as many scripted ones."""
    source: tuple[str, ...] = ("demos.source=scripted",)
    if demos is not None:
        source = ("demos.source=recordings", f"demos.path={demos}", f'demos.collections=["{RECORDINGS}"]')
    pages = (f"evaluate.episodes={study.pages}", f"evaluate.random_episodes={study.pages}")
    return (*source, "demos.per_task=32", *pages, *study.settings)
