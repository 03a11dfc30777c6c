"""Everything in one thread and no Ray: same seed, same bytes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from actors.agents import PolicyAgent
from actors.browser import open_browser
from actors.rollouts import Schedule, play
from giirl_core.config import Config
from giirl_core.goals import is_held_out
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.nets.parameters import load_net
from giirl_core.nets.reward import build_policy, build_reward
from giirl_core.types import Episode, Purpose, Weights


class SerialRuntime:
    """Plays when asked, scores what it played, waits for nobody."""

    def __init__(self, config: Config, metrics: Metrics, resume: Path | None) -> None:
        self._config, self._metrics = config, metrics
        self._browser = open_browser(config, metrics)
        self._chooser = PolicyAgent(
            build_policy(config), load_vectors(config.net.vectors), sampled_actions=config.sampled_actions
        )
        self._reward = build_reward(config)
        self._reward_version = 0
        self._played = 0  # episodes of each task
        if resume is not None:
            self._played = json.loads((resume / "runtime.json").read_text())["played"]

    def publish(self, policy: Weights, reward: Weights) -> None:
        self._chooser.load(policy)
        load_net(self._reward.net, reward)
        self._reward_version = reward.version

    def take(self, episodes: int) -> list[Episode]:
        """At least `episodes`, all begun and ended in this call; of every task equally many, but for goals held out."""
        finished: list[Episode] = []
        while len(finished) < episodes:
            finished += [e for e in self._play() if not is_held_out(e.trajectory.goal, self._config.held_out_goals)]
        return finished

    def _play(self) -> list[Episode]:
        quota = self._config.quota
        schedule = Schedule(
            self._config.tasks,
            self._browser.tabs,
            purpose=Purpose.TRAIN,
            run_seed=self._config.seed,
            first=self._played,
            quota=quota,
        )
        self._played += quota
        rounds = play(
            self._browser,
            self._chooser,
            schedule,
            step_limit=self._config.step_limit,
            metrics=self._metrics,
        )
        finished = [episode for some in rounds for episode in some]
        rewards = self._reward.score([episode.trajectory for episode in finished])
        return [
            replace(episode, trajectory=episode.trajectory.with_rewards(scored, self._reward_version))
            for episode, scored in zip(finished, rewards, strict=True)
        ]

    def addresses(self) -> dict[str, str]:
        """Nobody else to scrape."""
        return {}

    def save(self, folder: Path) -> None:
        """Which pages come next."""
        (folder / "runtime.json").write_text(json.dumps({"played": self._played}))

    def committed(self) -> None:
        """Nothing is under way between two steps."""

    def drain(self) -> None:
        """Nobody has anything to hand over."""

    def close(self) -> None:
        self._browser.close()
