"""What a runtime is, and the serial one: everything in one thread, without Ray. Same seed, same bytes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from actors.browser import open_browser
from actors.player import training_agent
from actors.rollouts import play_pages
from giirl.run.folder import RUNTIME_FILE
from giirl.throughput import StreamState
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import load_net
from giirl_core.nets.reward import build_reward
from giirl_core.telemetry.targets import node_address
from giirl_core.types import Episode, Purpose, is_held_out
from giirl_core.weights import Weights


class Runtime(Protocol):
    """Plays and scores episodes: in this thread, in processes on this machine, or in a Ray cluster."""

    node: str  # address of this machine, as other machines reach it

    def publish(self, policy: Weights, reward: Weights) -> None:
        """Use these weights from now on. The first call starts the actors."""

    def take(self, episodes: int) -> list[Episode]:
        """Wait for at least `episodes` new episodes with rewards. An empty list means that the run should stop."""

    def stream(self) -> StreamState:
        """The number of stale episodes and the idle fraction of the actors."""
        ...

    def addresses(self) -> dict[str, str]:
        """Metrics addresses "host:port" of the other processes, by name."""

    def save(self, folder: Path) -> None:
        """Write the runtime's part of a checkpoint into `folder`."""

    def committed(self) -> None:
        """Called when the checkpoint of the last `save` is complete on disk."""

    def drain(self) -> bool:
        """Stop playing and collect the finished episodes. Returns whether there is anything new to save."""

    def forget(self) -> None:
        """After `drain` and `save`: delete temporary files that a resumed run would need if nothing had been saved."""

    def close(self) -> None:
        """End all processes and close the browser."""


class SerialRuntime:
    """Plays a batch of episodes when the learner takes one, and scores it at once."""

    def __init__(self, config: Config, metrics: Metrics, resume: Path | None) -> None:
        self._config, self._metrics = config, metrics
        self.node = node_address()
        self._browser = open_browser(config, metrics)
        self._agent = training_agent(config)
        self._reward = build_reward(config)
        self._reward_version = 0
        self._played = 0  # pages of each task so far
        if resume is not None:
            self._played = json.loads((resume / RUNTIME_FILE).read_bytes())["played"]

    def publish(self, policy: Weights, reward: Weights) -> None:
        self._agent.load(policy)
        load_net(self._reward.net, reward)
        self._reward_version = reward.version

    def take(self, episodes: int) -> list[Episode]:
        """At least `episodes`, the same number of each task, all started and finished in this call.

        Episodes with a held-out goal are dropped; more are then played in their place.
        """
        finished: list[Episode] = []
        while len(finished) < episodes:
            finished += [e for e in self._play() if not is_held_out(e.trajectory.goal, self._config.held_out_goals)]
        return finished

    def _play(self) -> list[Episode]:
        pages, first = self._config.quota, self._played
        self._played += pages
        finished = play_pages(
            self._config, self._browser, self._agent, Purpose.TRAIN, pages, self._metrics, first=first
        )
        if not finished:
            reasons = "; ".join(self._browser.unopened.values()) or "the browser broke in each of them"
            raise RuntimeError(f"no episode of {pages} of each task could be played: {reasons}")
        rewards = self._reward.score([episode.trajectory for episode in finished])
        return [
            replace(episode, trajectory=episode.trajectory.with_rewards(scored, self._reward_version))
            for episode, scored in zip(finished, rewards, strict=True)
        ]

    def stream(self) -> StreamState:
        """No episode is stale and no tab is idle: episodes are played when the learner takes them."""
        return StreamState()

    def addresses(self) -> dict[str, str]:
        """There are no other processes."""
        return {}

    def save(self, folder: Path) -> None:
        """Write which pages come next."""
        (folder / RUNTIME_FILE).write_text(json.dumps({"played": self._played}), encoding="utf-8")

    def committed(self) -> None:
        """Nothing to do: no episode is in flight between two learner steps."""

    def drain(self) -> bool:
        """Nothing to do: there are no other processes."""
        return False

    def forget(self) -> None:
        """Nothing to do: there are no temporary files."""

    def close(self) -> None:
        self._browser.close()
