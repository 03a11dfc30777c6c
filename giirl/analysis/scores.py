"""A learned reward by itself: scoring the episodes of a file, and serving the reward on a port."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event
from typing import Any

import torch
from rich.table import Table

from giirl.signals import stopping
from giirl_core.config import Config
from giirl_core.gestures import read_gestures
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import RewardModel, build_reward
from giirl_core.telemetry.series import SERVICE
from giirl_core.types import Episode
from giirl_core.weights import Weights
from giirl_core.wire.messages import read_sound_episodes
from reward_service.service import RewardService

BATCH = 64  # episodes in one batch


def score_file(config: Config, reward: Weights, file: Path) -> dict[str, Any]:
    """The reward of every step in a demonstration file, with the outcome of each episode.

    `left_out` says which episodes are not scored, because they are damaged or have actions that the nets cannot
    represent.
    """
    sound, left_out = read_sound_episodes(file)
    gestures = read_gestures(config.net.gestures)
    reasons = [episode.trajectory.unlearnable(gestures) for episode in sound]
    episodes = [episode for episode, why in zip(sound, reasons, strict=True) if not why]
    left_out += filter(None, reasons)
    trajectories = [episode.trajectory for episode in episodes]
    score = build_reward(config, reward).score
    batches = [trajectories[i : i + BATCH] for i in range(0, len(trajectories), BATCH)]
    rewards = [part.tolist() for batch in batches for part in score(batch)]
    return {
        "reward_version": reward.version,
        "form": config.discriminator.reward,
        "left_out": left_out,
        "episodes": [_row(episode, steps) for episode, steps in zip(episodes, rewards, strict=True)],
    }


def score_table(scored: dict[str, Any]) -> Table:
    """Mean reward per step for each task, of successful and of failed episodes."""
    table = Table(title=f"reward ({scored['form']}), version {scored['reward_version']}, mean over steps")
    for name in ("task", "succeeded", "reward", "failed", "reward"):
        table.add_column(name, justify="left" if name == "task" else "right")
    episodes = scored["episodes"]
    for task in sorted({episode["task"] for episode in episodes}):
        cells = []
        for success in (True, False):
            own = [e["rewards"] for e in episodes if e["task"] == task and e["success"] is success]
            steps = [reward for rewards in own for reward in rewards]
            cells += [str(len(own)), f"{sum(steps) / len(steps):+.2f}" if steps else "-"]
        table.add_row(task, *cells)
    return table


def serve_reward(config: Config, reward: Weights, port: int, on_ready: Callable[[str], None]) -> None:
    """Serve the reward on a loopback port until Ctrl-C or SIGTERM; port 0 takes any free one.

    `on_ready` is called with the address.
    """
    torch.set_num_threads(1)
    service = RewardService(lambda weights: build_reward(config, weights).score, port=port)
    service.set_weights(reward)
    stop = Event()
    with stopping(stop):
        on_ready(service.address)
        service.serve(stop.is_set)


def serve_reward_over_http(
    reward: RewardModel, host: str, port: int, token: str, on_ready: Callable[[str], None]
) -> None:
    """Serve the reward as a JSON API until Ctrl-C or SIGTERM; port 0 takes any free one.

    `on_ready` is called with the address. ValueError for an address beyond loopback without a token.
    """
    from reward_service.http_api import open_server

    torch.set_num_threads(1)
    server = open_server(reward, Metrics(SERVICE), host=host, port=port, token=token)
    stop = Event()
    with stopping(stop):
        server.serve(stop, on_ready)


def _row(episode: Episode, rewards: Sequence[float]) -> dict[str, Any]:
    trajectory = episode.trajectory
    return {
        "task": trajectory.task,
        "goal": trajectory.goal.utterance,
        "seed": trajectory.seed,
        "success": episode.outcome.success,
        "rewards": [round(reward, 4) for reward in rewards],
        "return": round(sum(rewards), 4),
    }
