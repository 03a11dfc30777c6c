"""D_phi(s, a | g): trained to tell expert from policy, read as a reward."""

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
    pick_step,
    sampled_of,
    steps_of,
)
from learner.losses import gradient_penalty, logistic_loss, trimmed
from learner.protocols import ACCURACY, EXPERT

OWN = ("rollouts", "replay")  # steps that the policy took, at some time
LATELY = 0.05  # how much the newest batch counts in the accuracy of late
TAKEN, POLICYS, RANDOM = 0, 1, 2  # columns of the actions on each page


@dataclass(frozen=True, slots=True)
class _Pages:
    """What one iteration trains on: pages, actions on each, and which of those count as what."""

    batch: Batch  # B pages
    taken: ActionBatch  # [B, 1]
    own: ActionBatch  # [B, updates] the policy's, on expert pages
    random: ActionBatch  # [B, updates]
    sources: dict[str, tuple[float, slice, int]]  # by name: weight, rows and column of its actions

    def actions(self, update: int) -> ActionBatch:
        """[B, 3] those of one update: taken, the policy's, random."""
        return join(self.taken, self.own.columns(update, update + 1), self.random.columns(update, update + 1))


class Discriminator:
    """Binary logistic regression of expert (s, a, g) from the policy's, by the sources that the config weighs."""

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
        self.accuracy = 1.0  # of late: the mean share of expert steps, and of the newest rollouts', on their own side
        self.optimiser = torch.optim.Adam(model.net.parameters(), lr=config.learning_rate, fused=True)
        self._rng, self._generator = rng, generator
        self._used = {"service": 0, "learner": 0}  # rewards, by who computed them

    @property
    def service_share(self) -> float:
        """The share of the rewards used so far that the reward service computed."""
        return round(self._used["service"] / max(sum(self._used.values()), 1), 4)

    def update(self, expert: Sequence[Example], rollouts: Sequence[Example], policy: PolicyNet) -> dict[str, float]:
        """Train on fresh draws from `expert`, `rollouts` and the other sources; returns loss and accuracies.

        `d_accuracy_SOURCE` is the share of that source's pairs on the right side of D = 1/2.
        """
        stats: dict[str, float] = {}
        pages = self._gather(expert, rollouts, policy)
        for update in range(self.config.updates):
            with timed_update(self._metrics, "reward"):
                stats = self._descend(pages, update, policy)
        for name, value in stats.items():
            if name.startswith(ACCURACY):
                self._metrics.discriminator_accuracy.labels(name.removeprefix(ACCURACY)).set(value)
        if (on_rollouts := stats.get(f"{ACCURACY}rollouts")) is not None:
            self.accuracy += LATELY * ((stats[ACCURACY + EXPERT] + on_rollouts) / 2 - self.accuracy)
        self.replay.add(rollouts)
        return stats

    def rewards(self, rollouts: Sequence[Example], version: int) -> list[Tensor]:
        """r(s, a | g) [T, 1 + M] of every rollout: of the action taken and of the sampled ones.

        Rewards that came with a rollout are the reward service's, from this very function. Those more than `reward_lag`
        versions behind `version`, the one in the making, are computed again.
        """
        versions = [example.trajectory.reward_version for example in rollouts]
        carried = [scored != UNSCORED and 0 <= version - scored <= self._reward_lag for scored in versions]
        stale = [example for example, fresh in zip(rollouts, carried, strict=True) if not fresh]
        again = iter(self._score(stale))
        rewards = [
            carried_rewards(example) if fresh else next(again) for example, fresh in zip(rollouts, carried, strict=True)
        ]
        for source, wanted in (("service", True), ("learner", False)):
            used = sum(part.numel() for part, fresh in zip(rewards, carried, strict=True) if fresh is wanted)
            self._metrics.rewards_used.labels(source).inc(used)
            self._used[source] += used
        return rewards

    @torch.no_grad()
    def _score(self, rollouts: Sequence[Example]) -> list[Tensor]:
        """[T, 1 + M] of every rollout by the net as it is now."""
        if not rollouts:
            return []
        self.model.net.eval()
        device = self.model.device
        batch, taken = collate_steps(steps_of(rollouts))
        actions = join(taken, sampled_of(rollouts)[0])
        logits = self.model.net(batch.to(device), actions.to(device)).cpu()
        lengths = [len(example.features) for example in rollouts]
        return episode_rewards(logits, lengths, self.config.reward, self.config.clip)

    def _gather(self, expert: Sequence[Example], rollouts: Sequence[Example], policy: PolicyNet) -> _Pages:
        """The pages to train on, each to be encoded once an update, with an action of each kind for every update."""
        config, rng = self.config, self._rng
        pick = pick_step if config.train_on == "all_steps" else last_step
        steps = {
            EXPERT: [pick(expert[i % len(expert)], rng) for i in range(config.batch)],
            "rollouts": self._newest(rollouts),
            "replay": [pick(old, rng) for old in self.replay.sample(config.batch)] if config.replay else [],
            "wrong_goal": self.demos.wrong_goals(expert) if config.wrong_goal else [],
        }
        batch, taken = collate_steps([step for some in steps.values() for step in some])
        device = self.model.device
        uniform = torch.rand(len(batch), config.updates, 3, generator=self._generator)
        random = random_actions(batch, uniform)
        own = self._act(steps[EXPERT], policy, random)
        firsts = np.cumsum([0, *(len(some) for some in steps.values())]).tolist()
        sources = {
            name: (getattr(config, name, 1.0), slice(first, last), TAKEN)
            for name, first, last in zip(steps, firsts, firsts[1:], strict=False)
        }
        sources["policy_on_expert_states"] = config.policy_on_expert_states, slice(0, config.batch), POLICYS
        sources["random_actions"] = config.random_actions, slice(0, firsts[2], 2), RANDOM
        used = {name: part for name, part in sources.items() if part[0] and part[1].start < part[1].stop}
        return _Pages(batch.to(device), taken.to(device), own.to(device), random.to(device), used)

    def _newest(self, rollouts: Sequence[Example]) -> list[Step]:
        """Each step of the newest rollouts at most once."""
        steps = steps_of(rollouts)
        if self.config.train_on == "final_steps":
            steps = [last_step(rollout, self._rng) for rollout in rollouts]
        some = self._rng.permutation(len(steps))[: self.config.batch]
        return [steps[i] for i in some.tolist()]

    @torch.no_grad()
    def _act(self, shown: Sequence[Step], policy: PolicyNet, random: ActionBatch) -> ActionBatch:
        """[B, updates] the policy's actions on the expert pages, which come first; on the others random ones.

        The policy's actions on expert pages are a difference that no memory of pages can explain. Random actions keep
        what is wrong wrong for as long as training lasts, on the policy's pages too, where a good policy makes no
        mistakes any more and the right action would be the only one labelled as the policy's.
        """
        if not self.config.policy_on_expert_states:
            return random
        device = policy.device
        uniform = torch.rand(len(shown), self.config.updates, 3, generator=self._generator).to(device)
        own, _ = policy.sample(policy.encoder(collate([step.features for step in shown]).to(device)), uniform)
        return random.replace_first(own.to(random.verb.device))

    def _descend(self, pages: _Pages, update: int, policy: PolicyNet) -> dict[str, float]:
        config, net = self.config, self.model.net
        net.train()
        batch, actions = pages.batch, pages.actions(update)
        if config.rename_prob:
            batch = rename(batch, actions, config.rename_prob, config.position_jitter, self._generator)
        read = net.encode(net.encoder(batch), actions).flatten(0, 1)
        logits = net.head(read).view(len(batch), -1)
        if config.form == "airl":
            with torch.no_grad():  # by the page's own words, which are all that the policy knows
                logp, _ = policy.evaluate(policy.encoder(pages.batch), actions)
            logits = logits - logp
        parts = {name: logits[rows, column] for name, (_, rows, column) in pages.sources.items()}
        counted = {
            name: trimmed(part, config.discard_top_fraction) if name in OWN else part for name, part in parts.items()
        }
        negatives = [(w, counted[name]) for name, (w, *_) in pages.sources.items() if name != EXPERT]
        loss = logistic_loss(parts[EXPERT], negatives)
        penalty = 0 * loss
        if config.gradient_penalty:
            used = torch.cat(list(parts.values()))
            penalty = config.gradient_penalty * gradient_penalty(used, [read]) * len(read) / len(used)
        self.optimiser.zero_grad()
        (loss + penalty).backward()
        self.optimiser.step()
        stats = {"d_loss": loss.item(), "d_penalty": penalty.item()}
        for name, part in parts.items():
            right = part > 0 if name == EXPERT else part < 0
            stats[ACCURACY + name] = right.float().mean().item()
        return stats
