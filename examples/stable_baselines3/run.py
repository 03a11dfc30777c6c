"""PPO of Stable-Baselines3 on a learned reward and on the page's own: python -m examples.stable_baselines3.run REWARD

REWARD is a run of `giirl train` or a file of `giirl reward export`.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from typing import Any

import click
import gymnasium
import torch
from stable_baselines3 import PPO

import browser_farm  # noqa: F401 (registers the environment)
from examples.stable_baselines3.policy import SlotPolicy
from examples.stable_baselines3.slots import ElementSlots
from giirl import LearnedReward, LearnedRewardWrapper
from giirl.statistics import Score
from giirl_core.files import writable, write_json

EPISODE_STEPS = 5
EVALUATION = 1 << 31  # the first page of the evaluation; training draws pages below


def environment(task: str, reward: LearnedReward | None) -> ElementSlots:
    """The task with elements as actions; with the page's reward if none is given."""
    env: Any = gymnasium.make(
        "giirl/MiniWoB-v0", task=task, max_episode_steps=EPISODE_STEPS, agent_page=True, root_dom=False
    )
    return ElementSlots(env if reward is None else LearnedRewardWrapper(env, reward))


def success(env: ElementSlots, model: PPO | None, pages: int) -> dict[str, Any]:
    """Greedy success on fresh pages by the page's own verdict, with its 95 % interval; at random without a model."""
    score = Score(episodes=0, successes=0)
    env.action_space.seed(0)
    for seed in range(EVALUATION, EVALUATION + pages):
        observation, info = env.reset(seed=seed)
        over = False
        while not over:
            action = env.action_space.sample() if model is None else model.predict(observation, deterministic=True)[0]
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        if "lost" not in info:
            score += Score(episodes=1, successes=int(info["raw_reward"] == 1.0))
    return score.row() | {"missing": pages - score.episodes}


def compare(task: str, reward: LearnedReward, steps: int, pages: int, seed: int) -> dict[str, Any]:
    """Success of PPO after `steps` environment steps on either reward, and at random."""
    found: dict[str, Any] = {}
    for name, given in (("learned_reward", reward), ("page_reward", None)):
        start_s = time.monotonic()
        env = environment(task, given)
        try:
            if not found:
                found["random"] = success(env, None, pages)
            model = PPO(SlotPolicy, env, n_steps=256, ent_coef=0.02, learning_rate=1e-3, seed=seed, device="cpu")
            model.learn(steps)
            found[name] = success(env, model, pages) | {"seconds": round(time.monotonic() - start_s)}
        finally:
            env.close()
        click.echo(f"{task}, PPO on the {name.replace('_', ' ')}: {100 * found[name]['success']:.1f} % success")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("reward", help="a run, or an exported file")
    parser.add_argument("--task", default="click-button")
    parser.add_argument("--steps", type=int, default=3000, help="environment steps on each reward")
    parser.add_argument("--pages", type=int, default=300, help="fresh pages of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=writable)
    given = parser.parse_args()
    torch.set_num_threads(1)
    reward, load = LearnedReward(given.reward), os.getloadavg()
    found = compare(given.task, reward, given.steps, given.pages, given.seed)
    settings = {"task": given.task, "steps": given.steps, "seed": given.seed, "reward_version": reward.version}
    result = {**settings, **found, "load_before": load}
    if given.json:
        write_json(given.json, result)
    click.echo(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
