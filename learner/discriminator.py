"""The discriminator D_phi(s, a | g): learns to tell the expert from the policy, and is read as the reward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from giirl_core.config import DiscriminatorConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.action_batch import ActionBatch, join, random_actions
from giirl_core.nets.augment import rename
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.reward import RewardModel, episode_rewards
from giirl_core.types import UNSCORED
from learner.data import (
    Example,
    ExpertSampler,
    Replay,
    Step,
    carried_rewards,
    collate_steps,
    last_step,
    random_step,
    sampled_actions_of,
    steps_of,
)
from learner.losses import discard_top, gradient_penalty, logistic_loss
from learner.protocols import ACCURACY, EXPERT

POLICY_SOURCES = ("rollouts", "replay")  # steps that the current policy or an earlier one took
ACCURACY_RATE = 0.05  # of the moving average `Discriminator.accuracy`
TAKEN, POLICY, RANDOM = 0, 1, 2  # columns of the actions on each page


@dataclass(frozen=True, slots=True)
class _Samples:
    """The samples of one iteration: B pages, the actions on each, and the pages and actions of every source."""

    batch: Batch
    taken: ActionBatch  # [B, 1] by the expert or in a rollout
    policy: ActionBatch  # [B, updates] of the policy on expert pages; random ones on the other pages
    random: ActionBatch  # [B, updates] uniformly random
    sources: dict[str, tuple[float, slice, int]]  # by name: weight, its pages, the column of its actions

    def actions(self, update: int) -> ActionBatch:
        """[B, 3] the actions of one gradient update, in the columns TAKEN, POLICY and RANDOM."""
        return join(self.taken, self.policy.columns(update, update + 1), self.random.columns(update, update + 1))


class Discriminator:
    """Binary logistic regression of expert against policy (eq. 3.2 of Luo 2019), with the sources that `config` weighs.

    `accuracy` is a moving average over iterations: the mean of the accuracies on expert steps and on the newest
    rollouts. 1/2 means that the two look alike.
    """

    def __init__(
        self,
        config: DiscriminatorConfig,
        model: RewardModel,
        demos: ExpertSampler,
        replay: Replay,
        rng: np.random.Generator,
        generator: torch.Generator,
        *,
        reward_lag: int,
        metrics: Metrics,
    ) -> None:
        self.config, self.model, self.demos, self.replay = config, model, demos, replay
        self._reward_lag, self._metrics = reward_lag, metrics
        self.accuracy = 1.0
        self.marked_wrong: Sequence[Step] = ()  # by people; see learner/feedback.py
        self.optimiser = torch.optim.Adam(model.net.parameters(), lr=config.learning_rate, fused=True)
        self._rng, self._generator = rng, generator
        self._rewards_used = {"service": 0, "learner": 0}  # by the process that computed them

    @property
    def service_share(self) -> float:
        """Fraction of the rewards used so far that the reward service computed."""
        return round(self._rewards_used["service"] / max(sum(self._rewards_used.values()), 1), 4)

    def update(self, expert: Sequence[Example], rollouts: Sequence[Example], policy: PolicyNet) -> dict[str, float]:
        """Gradient steps on samples of `expert`, `rollouts` and the other sources, which older rollouts may be among.

        Returns the losses and accuracies of the last step. `d_accuracy_SOURCE` is the fraction of that source's samples
        on the right side of D = 1/2.
        """
        stats: dict[str, float] = {}
        samples = self._sample_sources(expert, rollouts, policy)
        for update in range(self.config.updates):
            with timed_update(self._metrics, "reward"):
                stats = self._train_batch(samples, update, policy)
        for name, value in stats.items():
            if name.startswith(ACCURACY):
                self._metrics.discriminator_accuracy.labels(name.removeprefix(ACCURACY)).set(value)
        if (on_rollouts := stats.get(f"{ACCURACY}rollouts")) is not None:
            self.accuracy += ACCURACY_RATE * ((stats[ACCURACY + EXPERT] + on_rollouts) / 2 - self.accuracy)
        if self.config.replay:
            self.replay.add(rollouts)
        return stats

    def rewards(self, rollouts: Sequence[Example], version: int) -> list[Tensor]:
        """r(s, a | g) [T, 1 + M] of every rollout: of the action taken and of the M sampled ones.

        `version` is that of the current reward. Most rollouts carry rewards of the reward service, from the same
        function. Rewards that are missing, more than `reward_lag` versions older, or newer (after a return to an
        earlier checkpoint) are computed here.
        """
        versions = [example.trajectory.reward_version for example in rollouts]
        is_fresh = [scored != UNSCORED and 0 <= version - scored <= self._reward_lag for scored in versions]
        rescored = iter(self._score([example for example, fresh in zip(rollouts, is_fresh, strict=True) if not fresh]))
        rewards = [
            carried_rewards(example) if fresh else next(rescored)
            for example, fresh in zip(rollouts, is_fresh, strict=True)
        ]
        for source, wanted in (("service", True), ("learner", False)):
            count = sum(part.numel() for part, fresh in zip(rewards, is_fresh, strict=True) if fresh is wanted)
            self._metrics.rewards_used.labels(source).inc(count)
            self._rewards_used[source] += count
        return rewards

    @torch.no_grad()
    def _score(self, rollouts: Sequence[Example]) -> list[Tensor]:
        """[T, 1 + M] rewards of every rollout from the current net."""
        if not rollouts:
            return []
        self.model.net.eval()
        device = self.model.device
        batch, taken = collate_steps(steps_of(rollouts))
        actions = join(taken, sampled_actions_of(rollouts)[0])
        logits = self.model.net(batch.to(device), actions.to(device)).cpu()
        lengths = [len(example.features) for example in rollouts]
        return episode_rewards(logits, lengths, self.config.reward, self.config.clip)

    def _sample_sources(self, expert: Sequence[Example], rollouts: Sequence[Example], policy: PolicyNet) -> _Samples:
        """The samples of one iteration: the same pages for all updates, with new policy and random actions for each."""
        config, rng = self.config, self._rng
        pick = random_step if config.train_on == "all_steps" else last_step
        steps = {
            EXPERT: [pick(expert[i % len(expert)], rng) for i in range(config.batch)],
            "rollouts": self._newest_steps(rollouts) if config.rollouts else [],
            "replay": [pick(old, rng) for old in self.replay.sample(config.batch)] if config.replay else [],
            "wrong_goal": self.demos.wrong_goals(expert) if config.wrong_goal else [],
            "wrong_step": self.demos.wrong_steps(expert) if config.wrong_step else [],
            "feedback": self._sample(self.marked_wrong) if config.feedback else [],
        }
        batch, taken = collate_steps([step for part in steps.values() for step in part])
        device = self.model.device
        uniform = torch.rand(len(batch), config.updates, 3, generator=self._generator)
        random = random_actions(batch, uniform, policy.gestures)
        by_policy = self._policy_actions(steps[EXPERT], policy, random)
        firsts = np.cumsum([0, *(len(part) for part in steps.values())]).tolist()
        sources = {
            name: (getattr(config, name, 1.0), slice(first, last), TAKEN)
            for name, first, last in zip(steps, firsts, firsts[1:], strict=False)
        }
        sources["policy_on_expert_states"] = config.policy_on_expert_states, slice(0, config.batch), POLICY
        every_other = slice(0, firsts[2], 2)  # of the pages of experts and of the newest rollouts
        sources["random_actions"] = config.random_actions, every_other, RANDOM
        used = {name: source for name, source in sources.items() if source[0] and source[1].start < source[1].stop}
        return _Samples(batch.to(device), taken.to(device), by_policy.to(device), random.to(device), used)

    def _newest_steps(self, rollouts: Sequence[Example]) -> list[Step]:
        """Steps of the newest rollouts, sampled without replacement."""
        steps = steps_of(rollouts)
        if self.config.train_on == "final_steps":
            steps = [last_step(rollout, self._rng) for rollout in rollouts]
        return self._sample(steps)

    def _sample(self, steps: Sequence[Step]) -> list[Step]:
        """At most `batch` of the steps, sampled without replacement."""
        chosen = self._rng.permutation(len(steps))[: self.config.batch]
        return [steps[i] for i in chosen.tolist()]

    @torch.no_grad()
    def _policy_actions(self, expert: Sequence[Step], policy: PolicyNet, random: ActionBatch) -> ActionBatch:
        """[B, updates] the policy's actions on the expert pages, which come first; `random` ones on the other pages.

        The policy's actions on expert pages are negatives that the discriminator cannot tell from the expert's by
        remembering pages. Random actions stay negatives for the whole training. They are also used on the policy's own
        pages: a good policy makes no mistakes there any more, so without them the only negatives on these pages would
        be correct actions.
        """
        if not self.config.policy_on_expert_states:
            return random
        device = policy.device
        uniform = torch.rand(len(expert), self.config.updates, 3, generator=self._generator).to(device)
        actions, _ = policy.sample(policy.encoder(collate([step.features for step in expert]).to(device)), uniform)
        return random.replace_first(actions.to(random.gesture.device))

    def _train_batch(self, samples: _Samples, update: int, policy: PolicyNet) -> dict[str, float]:
        config, net = self.config, self.model.net
        net.train()
        batch, actions = samples.batch, samples.actions(update)
        if config.rename_prob:
            batch = rename(batch, actions, config.rename_prob, config.position_jitter, self._generator)
        encoded = net.encode(net.encoder(batch), actions).flatten(0, 1)
        logits = net.head(encoded).view(len(batch), -1)
        if config.form == "airl":
            with torch.no_grad():  # on pages without renaming, because the policy acts on those
                logp, _ = policy.evaluate(policy.encoder(samples.batch), actions)
            logits = logits - logp
        parts = {name: logits[pages, column] for name, (_, pages, column) in samples.sources.items()}
        kept = {
            name: discard_top(part, config.discard_top_fraction) if name in POLICY_SOURCES else part
            for name, part in parts.items()
        }
        negatives = [(weight, kept[name]) for name, (weight, *_) in samples.sources.items() if name != EXPERT]
        loss = logistic_loss(parts[EXPERT], negatives)
        penalty = 0 * loss
        if config.gradient_penalty:
            used = torch.cat(list(parts.values()))
            penalty = config.gradient_penalty * gradient_penalty(used, [encoded]) * len(encoded) / len(used)
        self.optimiser.zero_grad()
        (loss + penalty).backward()
        self.optimiser.step()
        clipped = torch.cat(list(parts.values())).abs() >= config.clip
        stats = {"d_loss": loss.item(), "d_penalty": penalty.item(), "d_clipped": clipped.float().mean().item()}
        for name, part in parts.items():
            right = part > 0 if name == EXPERT else part < 0
            stats[ACCURACY + name] = right.float().mean().item()
        return stats
