"""GIIRL in LanguageGridCraft: the discriminator, soft Q-learning and cloning that the loop in learner.giirl drives."""

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
from giirl_core.nets.parameters import load_net, load_optimiser, serialise_net, serialise_optimiser
from giirl_core.nets.reward import reward_of
from giirl_core.weights import Weights
from gridcraft.instructions import ColourPair, plain_sentence, sentences
from gridcraft.world import HORIZON, World
from learner.grid.goal_features import BagOfWords
from learner.grid.nets import GridFeatures, GridRewardNet, PotentialNet, QNet, one_hot
from learner.grid.steps import EXPERT_TEMPERATURE, NO_STEPS, GridDemos, Index, Steps, expert_steps, random_steps
from learner.losses import gradient_penalty, logistic_loss
from learner.protocols import ACCURACY, EXPERT
from learner.schedules import anneal, anneal_discriminator

TARGET_RATE = 0.05  # weight of Q in each update of the moving average that acts and sets targets
RewardFn = Callable[[Steps], Tensor]


class GridDiscriminator:
    """Logistic regression of expert steps against the sources of negatives that the config weights (eq. 3.2)."""

    def __init__(
        self, config: Config, features: GridFeatures, demos: GridDemos, random: Steps, rng: np.random.Generator
    ) -> None:
        self.config: DiscriminatorConfig = config.discriminator
        self._gamma = config.policy.gamma
        self._features, self._demos, self._random, self._rng = features, demos, random, rng
        self.net = GridRewardNet(features.reward_width, config.net.width)
        self.potential = PotentialNet(features.reward_width, config.net.width)
        self.optimiser = torch.optim.Adam(
            [*self.net.parameters(), *self.potential.parameters()],
            lr=self.config.learning_rate,
            fused=True,
        )
        self.replay = NO_STEPS
        self.accuracy = 1.0  # on the newest rollouts

    def update(self, expert: Steps, rollouts: Steps, policy: QNet) -> dict[str, float]:
        """Train on new samples from each source. Returns the loss and the accuracy by source of the last batch."""
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            stats = self._train_batch(self._sample_sources(expert, rollouts, policy), policy)
        self.accuracy = stats.get(f"{ACCURACY}rollouts", self.accuracy)
        capacity = self.config.replay_size * HORIZON
        self.replay = Steps.join([self.replay, rollouts])
        self.replay = self.replay.pick(np.arange(max(len(self.replay) - capacity, 0), len(self.replay)))
        return stats

    def rewards(self, rollouts: Steps, version: int) -> Tensor:
        """[N] r(s_t, a_t | g) of every step, always from the current reward; `version` is ignored."""
        return self.reward_fn(rollouts)

    @torch.no_grad()
    def reward_fn(self, steps: Steps) -> Tensor:
        """[N] r(s, a | g). In the AIRL form it is computed from the logit without the shaping terms."""
        logit = self.net(self._features.reward_inputs(steps.state, steps.goal), one_hot(steps.action))
        return reward_of(logit, self.config.reward, self.config.clip)

    def _sample_sources(self, expert: Steps, rollouts: Steps, policy: QNet) -> dict[str, tuple[float, Steps]]:
        """The weight and a batch of each source, without sources of weight 0 or without steps."""
        config, rng = self.config, self._rng
        positives, new = expert.sample(config.batch, rng), rollouts.sample(config.batch, rng)
        sources = {
            EXPERT: (1.0, positives),
            "rollouts": (config.rollouts, new),
            "replay": (config.replay, self.replay.sample(config.batch, rng) if config.replay else NO_STEPS),
            "policy_on_expert_states": (
                config.policy_on_expert_states,
                self._policy_actions(positives, policy) if config.policy_on_expert_states else NO_STEPS,
            ),
            "random_actions": (config.random_actions, self._random.sample(config.batch, rng)),
            "wrong_goal": (config.wrong_goal, self._demos.wrong_goals(positives) if config.wrong_goal else NO_STEPS),
        }
        return {name: (weight, steps) for name, (weight, steps) in sources.items() if weight and len(steps)}

    @torch.no_grad()
    def _policy_actions(self, expert: Steps, policy: QNet) -> Steps:
        """The policy's actions in the expert's states. `following` stays the expert's; only the AIRL form reads it."""
        pi = policy.log_policy(self._features.policy_inputs(expert.state, expert.goal)).exp().numpy()
        action = (np.cumsum(pi, axis=1)[:, :-1] <= self._rng.random((len(expert), 1))).sum(axis=1)
        return Steps(state=expert.state, action=action, following=expert.following, goal=expert.goal)

    def _train_batch(self, sources: dict[str, tuple[float, Steps]], policy: QNet) -> dict[str, float]:
        config = self.config
        steps = Steps.join([steps for _, steps in sources.values()])
        inputs = [self._renamed_inputs(steps), one_hot(steps.action)]
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
        accuracy = {name: (part > 0 if name == EXPERT else part < 0).float().mean() for name, part in parts.items()}
        return {"d_loss": loss.item(), **{f"{ACCURACY}{name}": mean.item() for name, mean in accuracy.items()}}

    def _renamed_inputs(self, steps: Steps) -> Tensor:
        """[N, F + V] reward inputs. Each step has its colours permuted with probability `rename_prob`."""
        if not self.config.rename_prob:
            return self._features.reward_inputs(steps.state, steps.goal)
        states, goals = self._features.colour_permutations
        renamed = self._rng.random(len(steps)) < self.config.rename_prob
        permutation = torch.from_numpy(np.where(renamed, self._rng.integers(len(states), size=len(steps)), 0))
        state, goal = torch.from_numpy(steps.state), torch.from_numpy(steps.goal)
        return torch.cat([states[permutation, state], goals[permutation, goal]], dim=1)

    def _shaping(self, steps: Steps, inputs: Tensor, policy: QNet) -> Tensor:
        """[N] gamma h(s') - h(s) - log pi(a | s), the terms that AIRL adds to r(s, a) (Fu, Luo and Levine 2018)."""
        following = self.potential(self._features.reward_inputs(steps.following, steps.goal))
        shaping = self._gamma * following - self.potential(inputs)
        with torch.no_grad():
            pi = policy.log_policy(self._features.policy_inputs(steps.state, steps.goal))
            logp = pi.gather(1, torch.from_numpy(steps.action)[:, None]).squeeze(1)
        difference: Tensor = shaping - logp
        return difference


class GridSoftQ:
    """Soft Q-learning (Haarnoja et al. 2017) from the replay buffer and the steps of the random policy.

    `net`, the moving average of `q`, is both the target network and the policy that acts.
    """

    def __init__(
        self,
        config: Config,
        features: GridFeatures,
        goals: Index,
        random: Steps,
        rng: np.random.Generator,
        reward_fn: RewardFn,  # the current reward [N] of any steps
    ) -> None:
        self.config, self._grid, self._features, self._rng = config.policy, config.grid, features, rng
        self._reward_fn = reward_fn
        self._goals = goals  # [G] the sentences that training may use
        self.scale = config.discriminator.clip
        self.q = QNet(features.policy_width, 2 * config.net.width, self.config.entropy, self.scale)
        self.net = QNet(features.policy_width, 2 * config.net.width, self.config.entropy, self.scale)
        self.net.load_state_dict(self.q.state_dict())
        self.optimiser = torch.optim.Adam(self.q.parameters(), lr=self.config.learning_rate, fused=True)
        self._random, self.replay = random, NO_STEPS

    def update(self, rollouts: Steps, rewards: Tensor) -> dict[str, float]:
        """Gradient steps on the squared soft Bellman error, half on the replay buffer and half on random steps.

        Each step is relabelled with a random sentence (hindsight relabelling, Andrychowicz et al. 2017) and gets its
        current reward under that sentence. `rewards` [N] are only reported.
        """
        batch, updates, rng = self._grid.batch, self.config.updates, self._rng
        self.replay = Steps.join([self.replay, rollouts])
        half = updates * batch // 2
        steps = Steps.join([self.replay.sample(half, rng), self._random.sample(half, rng)])
        steps = steps.pick(rng.permutation(len(steps))).with_goals(rng.choice(self._goals, size=len(steps)))
        reward = self._reward_fn(steps) / self.scale
        inputs = self._features.policy_inputs(steps.state, steps.goal)
        following = self._features.policy_inputs(steps.following, steps.goal)
        action = torch.from_numpy(steps.action)[:, None]
        losses = []
        for i in range(updates):
            part = slice(i * len(steps) // updates, (i + 1) * len(steps) // updates)
            with torch.no_grad():
                target = soft_target(reward[part], self.net(following[part]), self.config.gamma, self._temperature)
            loss = functional.mse_loss(self.q(inputs[part]).gather(1, action[part]).squeeze(1), target)
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
    """Behavioural cloning with a network of the same shape as the Q network."""

    def __init__(self, config: Config, features: GridFeatures) -> None:
        self._features = features
        self.net = QNet(features.policy_width, 2 * config.net.width, 1.0, 1.0)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=config.cloning.learning_rate)

    def update(self, expert: Steps) -> dict[str, float]:
        """One gradient step on the negative log-likelihood of the expert's actions, without the absorbing end state."""
        steps = expert.pick(np.flatnonzero(expert.state != self._features.end_state))
        logp = self.net.log_policy(self._features.policy_inputs(steps.state, steps.goal))
        loss = functional.nll_loss(logp, torch.from_numpy(steps.action))
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return {"cloning_loss": loss.item()}


class GridLearner:
    """The complete training state in LanguageGridCraft: networks, optimisers, demonstrations, replay and RNG.

    The seed in the config determines every result.
    """

    def __init__(self, config: Config, world: World, pairs: Sequence[ColourPair]) -> None:
        torch.manual_seed(config.seed)
        self.version = 0  # finished iterations
        self.config, self.pairs, self.rng = config, tuple(pairs), np.random.default_rng([config.seed, 0])
        grid = config.grid
        by_pair = [(plain_sentence(p),) if grid.sentences == "plain" else sentences(p) for p in pairs]
        texts = [text for texts_of_pair in by_pair for text in texts_of_pair]
        self.sentences = dict(enumerate(texts))
        self.pair_index: Index = np.repeat(np.arange(len(pairs)), [len(own) for own in by_pair])  # [G] into pairs
        self.goals: Index = np.arange(len(texts))
        self.bag = BagOfWords(texts, grid.ngram_order)
        self.features = GridFeatures(world, texts, self.bag, grid)
        end_state = self.features.end_state if grid.absorbing else None
        goals = [np.flatnonzero(self.pair_index == i).tolist() for i in range(len(pairs))]
        expert = expert_steps(world, pairs, goals, grid.demonstrations, EXPERT_TEMPERATURE, self.rng, end_state)
        random = random_steps(world, self.goals.tolist(), grid.random_episodes, self.rng, end_state)
        self.random_env_steps = grid.random_episodes * HORIZON
        length = HORIZON + (end_state is not None)
        self.demos = GridDemos(expert, length, self.pair_index, self.goals, self.rng)
        self.discriminator = GridDiscriminator(config, self.features, self.demos, random, self.rng)
        d = self.discriminator
        self.policy = GridSoftQ(config, self.features, self.goals, random, self.rng, d.reward_fn)
        self.cloner = GridCloner(config, self.features)

    def featurise(self, episodes: Steps) -> Steps:
        """Return the steps unchanged: they need no preprocessing."""
        return episodes

    def anneal(self, step: int) -> None:
        """Set the learning rates for iteration `step`, from 0 to iterations - 1."""
        done = step / max(self.config.iterations - 1, 1)
        anneal_discriminator(self.discriminator, done)
        anneal(self.policy, done)

    @property
    def behaviour_policy(self) -> QNet:
        """The policy that plays: that of Algorithm 1, or the cloned one for algorithm "cloning"."""
        return self.policy.net if ALGORITHMS[self.config.algorithm].uses_reward else self.cloner.net

    def nets(self) -> dict[str, nn.Module]:
        """The trained networks by name."""
        return {
            "reward": self.discriminator.net,
            "potential": self.discriminator.potential,
            "policy": self.policy.net,
            "cloning": self.cloner.net,
        }

    def save(self, folder: Path) -> None:
        """Write the training state into an empty folder, except what the seed reproduces (demonstrations)."""
        for name, net in self._saved_nets().items():
            (folder / f"{name}.safetensors").write_bytes(serialise_net(net, self.version).blob)
        for name, part in self._parts().items():
            (folder / f"{name}_optimiser.safetensors").write_bytes(serialise_optimiser(part.optimiser))
        (folder / "reward_replay.safetensors").write_bytes(self.discriminator.replay.to_bytes())
        (folder / "policy_replay.safetensors").write_bytes(self.policy.replay.to_bytes())
        state = {"version": self.version, "accuracy": self.discriminator.accuracy, "rng": self.rng.bit_generator.state}
        (folder / "learner.json").write_text(json.dumps(state, indent=2), encoding="utf-8")

    def load(self, folder: Path) -> None:
        """Restore what `save` wrote. ValueError if the checkpoint belongs to networks of another shape."""
        state: dict[str, Any] = json.loads((folder / "learner.json").read_bytes())
        for name, net in self._saved_nets().items():
            load_net(net, Weights.with_digest(state["version"], (folder / f"{name}.safetensors").read_bytes()))
        for name, part in self._parts().items():
            load_optimiser(part.optimiser, (folder / f"{name}_optimiser.safetensors").read_bytes())
        self.discriminator.replay = Steps.from_bytes((folder / "reward_replay.safetensors").read_bytes())
        self.policy.replay = Steps.from_bytes((folder / "policy_replay.safetensors").read_bytes())
        self.rng.bit_generator.state = state["rng"]
        self.version, self.discriminator.accuracy = state["version"], state["accuracy"]

    def _saved_nets(self) -> dict[str, nn.Module]:
        return {**self.nets(), "q": self.policy.q}

    def _parts(self) -> dict[str, GridDiscriminator | GridSoftQ | GridCloner]:
        return {"reward": self.discriminator, "policy": self.policy, "cloning": self.cloner}
