"""The variants that the studies of web tasks compare: settings of algorithms, nets and demonstrations."""

from __future__ import annotations

import json

from browser_farm.experts import EXPERTS
from giirl.studies import fifty_two
from giirl.studies.runner import Variant

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
    "discriminator.wrong_step=1",
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


def budget_variants() -> tuple[Variant, ...]:
    """GIIRL and cloning with few demonstrations, then with noisy ones."""
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


def tuning_variants() -> tuple[Variant, ...]:
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


def family_variants() -> tuple[Variant, ...]:
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
