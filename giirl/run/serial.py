"""The serial runtime: everything in one thread, without Ray. Same seed, same bytes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from actors.agents import PolicyAgent
from actors.browser import open_browser
from actors.rollouts import play_pages
from giirl.run.folder import RUNTIME_FILE
from giirl.throughput import StreamState
from giirl_core.config import Config
from giirl_core.goals import is_held_out
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.nets.parameters import load_net
from giirl_core.nets.reward import build_policy, build_reward
from giirl_core.types import Episode, Purpose
from giirl_core.weights import Weights


class SerialRuntime:
    """Plays a batch of episodes when the learner takes one, and scores it at once."""

    def __init__(self, config: Config, metrics: Metrics, resume: Path | None) -> None:
        self._config, self._metrics = config, metrics
        self._browser = open_browser(config, metrics)
        self._agent = PolicyAgent(
            build_policy(config), load_vectors(config.net.vectors), sampled_actions=config.sampled_actions
        )
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

    def drain(self) -> None:
        """Nothing to do: there are no other processes."""

    def close(self) -> None:
        self._browser.close()
