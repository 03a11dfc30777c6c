"""GIIRL in LanguageGridCraft: a discriminator and soft Q-learning with the verbs that learner.giirl uses."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config, DiscriminatorConfig
from giirl_core.nets.parameters import load_net, load_optimiser, seal_net, seal_optimiser
from giirl_core.nets.reward import reward_of
from giirl_core.types import Weights
from gridcraft.instructions import Pair, plain_sentence, sentences
from gridcraft.world import HORIZON, World
from learner.grid.goal_features import BagOfWords
from learner.grid.nets import GridFeatures, PotentialNet, QNet, RewardNet, one_hot
from learner.grid.steps import EXPERT_TEMPERATURE, NOTHING, GridDemos, Index, Steps, expert_steps, random_steps
from learner.losses import gradient_penalty, logistic_loss
from learner.protocols import ACCURACY, EXPERT
from learner.schedules import anneal, anneal_reward

TARGET_RATE = 0.05  # how fast the net that acts and sets targets follows Q
RewardFn = Callable[[Steps], Tensor]


class GridDiscriminator:
    """Binary logistic regression of the expert's steps from the sources of negatives that the config weighs."""

    def __init__(
        self, config: Config, sight: GridFeatures, demos: GridDemos, chance: Steps, rng: np.random.Generator
    ) -> None:
        self.config: DiscriminatorConfig = config.discriminator
        self._gamma = config.policy.gamma
        self._sight, self._demos, self._chance, self._rng = sight, demos, chance, rng
        self.net = RewardNet(sight.width, config.net.width)
        self.potential = PotentialNet(sight.width, config.net.width)
        self.optimiser = torch.optim.Adam(
            [*self.net.parameters(), *self.potential.parameters()],
            lr=self.config.learning_rate,
            fused=True,
        )
        self.old = NOTHING
        self.accuracy = 1.0  # share of the newest rollouts that it took for the policy's

    def update(self, expert: Steps, rollouts: Steps, policy: QNet) -> dict[str, float]:
        """Train on fresh draws from each source; returns the loss and the share of each source judged rightly."""
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            stats = self._descend(self._sources(expert, rollouts, policy), policy)
        self.accuracy = stats.get(f"{ACCURACY}rollouts", self.accuracy)
        kept = self.config.replay_size * HORIZON
        self.old = Steps.join([self.old, rollouts])
        self.old = self.old.pick(np.arange(max(len(self.old) - kept, 0), len(self.old)))
        return stats

    def rewards(self, rollouts: Steps, version: int) -> Tensor:
        """r(s_t, a_t | g) [N] of every step; always of the reward just learned, whatever its `version`."""
        return self.reward_fn(rollouts)

    @torch.no_grad()
    def reward_fn(self, steps: Steps) -> Tensor:
        """r(s, a | g) [N]; of the AIRL form, the part of its logit that is no shaping."""
        logit = self.net(self._sight(steps.state, steps.goal), one_hot(steps.action))
        return reward_of(logit, self.config.reward, self.config.clip)

    def _sources(self, expert: Steps, rollouts: Steps, policy: QNet) -> dict[str, tuple[float, Steps]]:
        config, rng = self.config, self._rng
        shown, new = expert.draw(config.batch, rng), rollouts.draw(config.batch, rng)
        sources = {
            EXPERT: (1.0, shown),
            "rollouts": (config.rollouts, new),
            "replay": (config.replay, self.old.draw(config.batch, rng) if config.replay else NOTHING),
            "policy_on_expert_states": (
                config.policy_on_expert_states,
                self._act(shown, policy) if config.policy_on_expert_states else NOTHING,
            ),
            "random_actions": (config.random_actions, self._chance.draw(config.batch, rng)),
            "wrong_goal": (config.wrong_goal, self._demos.wrong_goals(shown) if config.wrong_goal else NOTHING),
        }
        return {name: (weight, steps) for name, (weight, steps) in sources.items() if weight and len(steps)}

    @torch.no_grad()
    def _act(self, shown: Steps, policy: QNet) -> Steps:
        """What the policy would do in the experts' states. Where it leads is not asked: only AIRL's form would be."""
        pi = policy.log_policy(self._sight.wide(shown.state, shown.goal)).exp().numpy()
        action = (np.cumsum(pi, axis=1)[:, :-1] <= self._rng.random((len(shown), 1))).sum(axis=1)
        return Steps(state=shown.state, action=action, following=shown.following, goal=shown.goal)

    def _descend(self, sources: dict[str, tuple[float, Steps]], policy: QNet) -> dict[str, float]:
        config = self.config
        steps = Steps.join([steps for _, steps in sources.values()])
        inputs = [self._see(steps), one_hot(steps.action)]
        for tensor in inputs:
            tensor.requires_grad_(config.gradient_penalty > 0)
        logits = self.net(*inputs)
        if config.form == "airl":
            logits = logits + self._shaping(steps, inputs[0], policy)
        parts = dict(zip(sources, logits.split([len(s) for _, s in sources.values()]), strict=True))
        loss = logistic_loss(parts[EXPERT], [(w, parts[name]) for name, (w, _) in sources.items() if name != EXPERT])
        penalty = config.gradient_penalty * gradient_penalty(logits, inputs) if config.gradient_penalty else 0 * loss
        self.optimiser.zero_grad()
        (loss + penalty).backward()
        self.optimiser.step()
        right = {name: (part > 0 if name == EXPERT else part < 0).float().mean() for name, part in parts.items()}
        return {"d_loss": loss.item(), **{f"{ACCURACY}{name}": share.item() for name, share in right.items()}}

    def _see(self, steps: Steps) -> Tensor:
        """[N, F + V], a share of `rename` with the names of the colours swapped, in sight and sentence alike."""
        if not self.config.rename_prob:
            return self._sight(steps.state, steps.goal)
        states, goals = self._sight.renamings
        swapped = self._rng.random(len(steps)) < self.config.rename_prob
        names = torch.from_numpy(np.where(swapped, self._rng.integers(len(states), size=len(steps)), 0))
        state, goal = torch.from_numpy(steps.state), torch.from_numpy(steps.goal)
        return torch.cat([states[names, state], goals[names, goal]], dim=1)

    def _shaping(self, steps: Steps, seen: Tensor, policy: QNet) -> Tensor:
        """gamma h(s') - h(s) - log pi(a | s), what AIRL (Fu, Luo and Levine 2018) adds to r(s, a)."""
        following = self.potential(self._sight(steps.following, steps.goal))
        shaped = self._gamma * following - self.potential(seen)
        with torch.no_grad():
            pi = policy.log_policy(self._sight.wide(steps.state, steps.goal))
            logp = pi.gather(1, torch.from_numpy(steps.action)[:, None]).squeeze(1)
        difference: Tensor = shaped - logp
        return difference


class GridSoftQ:
    """Soft Q-learning (Haarnoja et al. 2017) from new steps, old ones and chance's.

    `net`, the moving average of `q`, is the target net, and the policy that acts: it does not follow every gradient.
    """

    def __init__(
        self, config: Config, sight: GridFeatures, goals: Index, chance: Steps, rng: np.random.Generator
    ) -> None:
        self.config, self._grid, self._sight, self._rng = config.policy, config.grid, sight, rng
        self._goals = goals  # [G] the sentences that training may see
        self.scale = config.discriminator.clip
        self.q = QNet(sight.far_width, 2 * config.net.width, self.config.entropy, self.scale)
        self.net = QNet(sight.far_width, 2 * config.net.width, self.config.entropy, self.scale)
        self.net.load_state_dict(self.q.state_dict())
        self.optimiser = torch.optim.Adam(self.q.parameters(), lr=self.config.learning_rate, fused=True)
        self._chance, self.old = chance, NOTHING

    def update(self, rollouts: Steps, rewards: Tensor, reward_fn: RewardFn) -> dict[str, float]:
        """Steps of gradient descent on the soft Bellman error, on steps old and new.

        Each is learned from under any of the sentences, whichever it was played under (hindsight relabelling,
        Andrychowicz et al. 2017): `ask` tells what it would have earned, and today.
        """
        batch, updates, rng = self._grid.batch, self.config.updates, self._rng
        self.old = Steps.join([self.old, rollouts])
        drawn = Steps.join([self.old.draw(updates * batch // 2, rng), self._chance.draw(updates * batch // 2, rng)])
        drawn = drawn.pick(rng.permutation(len(drawn))).under(rng.choice(self._goals, size=len(drawn)))
        told = reward_fn(drawn) / self.scale
        wide = self._sight.wide
        seen, after = wide(drawn.state, drawn.goal), wide(drawn.following, drawn.goal)
        action = torch.from_numpy(drawn.action)[:, None]
        losses = []
        for i in range(updates):
            part = slice(i * len(drawn) // updates, (i + 1) * len(drawn) // updates)
            with torch.no_grad():
                target = soft_target(told[part], self.net(after[part]), self.config.gamma, self._temperature)
            loss = functional.mse_loss(self.q(seen[part]).gather(1, action[part]).squeeze(1), target)
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
            with torch.no_grad():
                torch._foreach_lerp_(list(self.net.parameters()), list(self.q.parameters()), TARGET_RATE)
            losses.append(loss.item())
        return {"p_loss": float(np.mean(losses)), "p_reward": rewards.mean().item()}

    @property
    def _temperature(self) -> float:
        return self.config.entropy / self.scale


def soft_target(reward: Tensor, q: Tensor, gamma: float, temperature: float) -> Tensor:
    """[N] r + gamma alpha log sum_a exp(Q(s', a) / alpha), from rewards [N] and Q [N, A] of the next states."""
    return reward + gamma * temperature * torch.logsumexp(q / temperature, dim=1)


class GridCloner:
    """Behavioural cloning with a net of the same shape as Q's."""

    def __init__(self, config: Config, sight: GridFeatures) -> None:
        self._sight = sight
        self.net = QNet(sight.far_width, 2 * config.net.width, 1.0, 1.0)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=config.cloning.learning_rate)

    def update(self, expert: Steps) -> dict[str, float]:
        """One step towards the actions of the expert; those in an absorbing end teach nothing."""
        shown = expert.pick(np.flatnonzero(expert.state != self._sight.end))
        logp = self.net.log_policy(self._sight.wide(shown.state, shown.goal))
        loss = functional.nll_loss(logp, torch.from_numpy(shown.action))
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return {"cloning_loss": loss.item()}


class GridLearner:
    """pi_theta and D_phi of LanguageGridCraft and what trains them. The config's seed fixes every number."""

    def __init__(self, config: Config, world: World, pairs: Sequence[Pair]) -> None:
        torch.manual_seed(config.seed)
        self.version = 0  # steps done
        self.config, self.pairs, self.rng = config, tuple(pairs), np.random.default_rng([config.seed, 0])
        grid = config.grid
        said = [(plain_sentence(p),) if grid.sentences == "plain" else sentences(p) for p in pairs]
        texts = [text for some in said for text in some]
        self.sentences = dict(enumerate(texts))
        self.meaning: Index = np.repeat(np.arange(len(pairs)), [len(some) for some in said])  # [G] which of the pairs
        self.goals: Index = np.arange(len(texts))
        self.bag = BagOfWords(texts, grid.order)
        self.sight = GridFeatures(world, texts, self.bag, grid)
        end = self.sight.end if grid.absorbing else None
        numbers = [np.flatnonzero(self.meaning == i).tolist() for i in range(len(pairs))]
        shown = expert_steps(world, pairs, numbers, grid.demonstrations, EXPERT_TEMPERATURE, self.rng, end)
        chance = random_steps(world, self.goals.tolist(), grid.random_episodes, self.rng, end)
        self.chance_env_steps = grid.random_episodes * HORIZON
        self.demos = GridDemos(shown, HORIZON + (end is not None), self.meaning, self.goals, self.rng)
        self.discriminator = GridDiscriminator(config, self.sight, self.demos, chance, self.rng)
        self.policy = GridSoftQ(config, self.sight, self.goals, chance, self.rng)
        self.cloner = GridCloner(config, self.sight)

    def featurise(self, episodes: Steps) -> Steps:
        """Steps are what the nets see already."""
        return episodes

    def anneal(self, step: int) -> None:
        """Set the learning rates of step 0 .. iterations - 1."""
        done = step / max(self.config.iterations - 1, 1)
        anneal_reward(self.discriminator, done)
        anneal(self.policy, done)

    @property
    def acting(self) -> QNet:
        """The policy that plays: what Algorithm 1 improves, or what was cloned."""
        return self.policy.net if ALGORITHMS[self.config.algorithm].uses_reward else self.cloner.net

    def nets(self) -> dict[str, nn.Module]:
        """What was learned, by name."""
        return {
            "reward": self.discriminator.net,
            "potential": self.discriminator.potential,
            "policy": self.policy.net,
            "cloning": self.cloner.net,
        }

    def save(self, folder: Path) -> None:
        """Write everything that the next step depends on, and the seed does not tell, into an empty folder."""
        for name, net in self._saved_nets().items():
            (folder / f"{name}.safetensors").write_bytes(seal_net(net, self.version).blob)
        for name, part in self._parts().items():
            (folder / f"{name}_optimiser.safetensors").write_bytes(seal_optimiser(part.optimiser))
        (folder / "reward_replay.safetensors").write_bytes(self.discriminator.old.seal())
        (folder / "policy_replay.safetensors").write_bytes(self.policy.old.seal())
        state = {"version": self.version, "accuracy": self.discriminator.accuracy, "rng": self.rng.bit_generator.state}
        (folder / "learner.json").write_text(json.dumps(state, indent=2))

    def load(self, folder: Path) -> None:
        """The inverse of `save`; ValueError when the checkpoint is of other nets."""
        state: dict[str, Any] = json.loads((folder / "learner.json").read_text())
        for name, net in self._saved_nets().items():
            load_net(net, Weights.seal(state["version"], (folder / f"{name}.safetensors").read_bytes()))
        for name, part in self._parts().items():
            load_optimiser(part.optimiser, (folder / f"{name}_optimiser.safetensors").read_bytes())
        self.discriminator.old = Steps.unseal((folder / "reward_replay.safetensors").read_bytes())
        self.policy.old = Steps.unseal((folder / "policy_replay.safetensors").read_bytes())
        self.rng.bit_generator.state = state["rng"]
        self.version, self.discriminator.accuracy = state["version"], state["accuracy"]

    def _saved_nets(self) -> dict[str, nn.Module]:
        return {**self.nets(), "q": self.policy.q}

    def _parts(self) -> dict[str, GridDiscriminator | GridSoftQ | GridCloner]:
        return {"reward": self.discriminator, "policy": self.policy, "cloning": self.cloner}
