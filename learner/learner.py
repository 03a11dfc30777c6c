"""The complete training state of the web learner (nets, optimisers, replay buffer, RNG state), with save and load."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.gestures import read_gestures
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.nets.parameters import hash_nets, load_net, load_optimiser, serialise_net, serialise_optimiser
from giirl_core.nets.reward import build_policy, build_reward
from giirl_core.types import Episode, Outcome, Trajectory
from giirl_core.weights import Weights
from giirl_core.wire.messages import read_episodes, write_episodes
from learner.actor_critic import ActorCritic
from learner.cloning import Cloner
from learner.data import Example, ExpertSampler, Replay, carried_rewards, featurise_trajectory
from learner.devices import learner_device
from learner.discriminator import Discriminator
from learner.feedback import Heard
from learner.schedules import anneal, anneal_discriminator, linear_decay
from learner.soft_q import SoftQ

UNKNOWN_OUTCOME = Outcome(raw_reward=0.0, ended=False)  # the replay buffer stores no outcomes


class Learner:
    """pi_theta, D_phi and their update rules for web pages.

    Deterministic on the CPU with one thread: the same config, demonstrations and rollouts give the same parameters.
    """

    def __init__(self, config: Config, demonstrations: Sequence[Trajectory], metrics: Metrics) -> None:
        torch.manual_seed(config.seed)
        self.vectors = load_vectors(config.net.vectors)
        self._rng = np.random.default_rng([config.seed, 0])
        self._generator = torch.Generator().manual_seed(config.seed)
        self.gestures = read_gestures(config.net.gestures)
        self.demos = ExpertSampler(demonstrations, self.vectors, self._rng, self.gestures)
        self.replay = Replay(config.discriminator.replay_size, self._rng)
        device = learner_device(config)
        reward = build_reward(config)
        reward.net.to(device)
        self.discriminator = Discriminator(
            config.discriminator,
            reward,
            self.demos,
            self.replay,
            self._rng,
            self._generator,
            reward_lag=config.stream.reward_lag,
            metrics=metrics,
        )
        net = build_policy(config).to(device)
        self.policy = ActorCritic(config.policy, net, metrics=metrics)
        self.cloner = Cloner(config.cloning, net, self._generator, metrics=metrics)
        self.soft_q = SoftQ(
            config.soft_q, config.algorithm, net, self.replay, self._rng, self._generator, metrics=metrics
        )
        self.config = config
        self.version = 0  # iterations done

    def featurise(self, trajectories: Sequence[Trajectory]) -> list[Example]:
        """Trajectories with the features that the nets read."""
        return [featurise_trajectory(trajectory, self.vectors, self.gestures) for trajectory in trajectories]

    def carried_rewards(self, rollouts: Sequence[Example]) -> list[Tensor]:
        """The rewards [T, 1 + M] stored in the rollouts."""
        return [carried_rewards(example) for example in rollouts]

    def successes(self, rollouts: Sequence[Example]) -> list[Example]:
        """The rollouts whose stored rewards sum to 1, the page's full reward."""
        return [example for example in rollouts if example.trajectory.rewards.sum() == 1.0]

    def hear(self, heard: Heard) -> None:
        """Answers of people join the demonstrations and the negatives, in place of those of an earlier call."""
        self.demos.join(heard.demonstrations)
        self.discriminator.marked_wrong = heard.wrong

    def anneal(self, step: int) -> None:
        """Set the learning rates and the entropy weight for `step` in 0 .. iterations - 1.

        They fall over the run, because a reward that keeps changing destabilises a policy that has solved its tasks.
        """
        progress = step / max(self.config.iterations - 1, 1)
        anneal_discriminator(self.discriminator, progress)
        anneal(self.policy, progress)
        self.policy.entropy = linear_decay(
            self.config.policy.entropy, self.config.policy.final_entropy_fraction, progress
        )
        self.policy.frozen = step < self.config.policy.frozen_iterations
        goes_on_cloning = self.config.policy.cloning_updates and ALGORITHMS[self.config.algorithm].uses_reward
        anneal(self.cloner, 1.0 if goes_on_cloning else progress)
        anneal(self.soft_q, progress)

    def bc_warmup(self) -> Iterator[dict[str, float]]:
        """Behavioural cloning for `policy.bc_warmup_updates` updates, to be run before the first iteration.

        Yields the statistics of each update.
        """
        updates = self.config.policy.bc_warmup_updates
        for update in range(updates):
            anneal(self.cloner, update / updates)
            yield self.cloner.update(self.demos.sample(self.config.cloning.batch))
        self.soft_q.update_target(1.0)
        if self.policy.prior is not None:
            self.policy.prior.load_state_dict(self.policy.net.state_dict())
            if ALGORITHMS[self.config.algorithm].reward == "learned":
                self.discriminator.model.net.encoder.load_state_dict(self.policy.net.encoder.state_dict())

    def load_reward(self, weights: Weights) -> None:
        """Use the reward net of another run. ValueError if its parameters have other names or shapes."""
        load_net(self.discriminator.model.net, weights)

    def weights(self) -> tuple[Weights, Weights]:
        """The current parameters of the policy and of the reward."""
        return serialise_net(self.policy.net, self.version), serialise_net(self.discriminator.model.net, self.version)

    def hash(self) -> str:
        """The sha256 of the parameters of policy and reward, in hex."""
        return hash_nets(self.policy.net, self.discriminator.model.net)

    def save(self, folder: Path) -> None:
        """Write the state that the next iteration depends on into an empty folder."""
        for name, net in self._nets().items():
            (folder / f"{name}.safetensors").write_bytes(serialise_net(net, self.version).blob)
        for name, optimiser in self._optimisers().items():
            (folder / f"{name}_optimiser.safetensors").write_bytes(serialise_optimiser(optimiser))
        episodes = [Episode(trajectory=e.trajectory, outcome=UNKNOWN_OUTCOME) for e in self.replay.examples]
        write_episodes(folder / "replay.giirl", episodes)
        state = {
            "version": self.version,
            "replay_seen": self.replay.seen,
            "replay_priorities": self.replay.priorities,
            "discriminator_accuracy": self.discriminator.accuracy,
            "rng": self._rng.bit_generator.state,
            "generator": bytes(self._generator.get_state().tolist()).hex(),
        }
        (folder / "learner.json").write_text(json.dumps(state, indent=2), encoding="utf-8")

    def load(self, folder: Path) -> None:
        """The inverse of `save`. ValueError if the files are of a learner with other nets, or of no learner."""
        try:
            self._load(folder)
        except (LookupError, TypeError, AttributeError, OverflowError, RuntimeError, SafetensorError) as error:
            raise ValueError(f"{folder} is no checkpoint of a learner with these settings: {error!r:.200}") from error

    def _load(self, folder: Path) -> None:
        state: dict[str, Any] = json.loads((folder / "learner.json").read_bytes())
        for name, net in self._nets().items():
            load_net(net, Weights.with_digest(state["version"], (folder / f"{name}.safetensors").read_bytes()))
        for name, optimiser in self._optimisers().items():
            load_optimiser(optimiser, (folder / f"{name}_optimiser.safetensors").read_bytes())
        self.replay.examples = self.featurise([e.trajectory for e in read_episodes(folder / "replay.giirl")])
        self.replay.seen, self.replay.priorities = state["replay_seen"], state["replay_priorities"]
        self.discriminator.accuracy = state["discriminator_accuracy"]
        self._rng.bit_generator.state = state["rng"]
        self._generator.set_state(torch.tensor(list(bytes.fromhex(state["generator"])), dtype=torch.uint8))
        self.version = state["version"]

    def _nets(self) -> dict[str, nn.Module]:
        nets: dict[str, nn.Module] = {"policy": self.policy.net, "reward": self.discriminator.model.net}
        if self.soft_q.target is not self.policy.net:
            nets["target"] = self.soft_q.target
        if self.policy.prior is not None:
            nets["prior"] = self.policy.prior
        return nets

    def _optimisers(self) -> Mapping[str, torch.optim.Optimizer]:
        return {
            "policy": self.policy.optimiser,
            "reward": self.discriminator.optimiser,
            "cloning": self.cloner.optimiser,
            "soft_q": self.soft_q.optimiser,
        }
