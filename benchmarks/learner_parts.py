"""CPU time of each part of Algorithm 1's iteration on the fixture of pages; a program of its own, printing JSON.

    python benchmarks/learner_parts.py four|mix ROUNDS FOLDER

FOLDER holds the fixture's module, so that the checkout on PYTHONPATH may be an earlier one: `benchmarks.learner` starts
this program on two checkouts in turn and compares them. Where a checkout's policy update takes a reward function
instead of sampled actions, it is given that.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from giirl_core.config import Config
from giirl_core.metrics import Metrics
from learner.learner import Learner

FOUR = ("click-test", "click-test-2", "click-button", "enter-text")
EPISODES = 32  # in an iteration of the four tasks; of the mix one for each task


def main(mix: bool, rounds: int, folder: Path) -> dict[str, Any]:
    """Median CPU milliseconds of each part, and of a cloning update."""
    torch.set_num_threads(1)
    demonstrations, rollouts = _fixture(folder)
    if mix:
        rollouts = rollouts[::2]
    else:
        demonstrations = [t for t in demonstrations if t.task in FOUR]
        rollouts = [replace(t, policy_version=0) for t in (demonstrations * 2)[:EPISODES]]
    tasks = tuple(sorted({t.task for t in demonstrations}))
    config = Config(tasks=tasks, rollout_batch=len(rollouts), iterations=1000)
    learner = Learner(config, demonstrations, Metrics())
    asks = "reward_fn" in inspect.signature(learner.policy.update).parameters
    if not asks:
        rollouts = _with_sampled(rollouts, learner, config.policy.sampled_actions)
    parts = [_iteration(learner, rollouts, config, asks) for _ in range(rounds + 1)][1:]
    cloning = [_cloning(learner, config) for _ in range(rounds + 1)][1:]
    ms = {name: 1e3 * statistics.median(part[name] for part in parts) for name in parts[0]}
    return {
        "episodes": len(rollouts),
        "steps": sum(map(len, rollouts)),
        "ms": {name: round(value, 2) for name, value in ms.items()},
        "cloning_ms_per_step": round(1e3 * statistics.median(cloning), 4),
    }


def _fixture(folder: Path) -> tuple[list[Any], list[Any]]:
    spec = importlib.util.spec_from_file_location("pages", folder / "pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: tuple[list[Any], list[Any]] = module.load()
    return found


def _with_sampled(rollouts: list[Any], learner: Any, count: int) -> list[Any]:
    """The rollouts as actors and the reward service send them: with scored sampled actions."""
    from actors.agents import PolicyAgent
    from giirl_core.sampled_actions import SampledActions
    from giirl_core.types import EpisodeSpec, Observation

    agent, rng = PolicyAgent(learner.policy.net, learner.vectors, sampled_actions=count), np.random.default_rng(0)
    done = []
    for t in rollouts:
        seen = [Observation(episode=EpisodeSpec(task=t.task, seed=t.seed), page=page, goal=t.goal) for page in t.pages]
        decisions: list[Any] = agent.select_actions(seen, rng.random((len(seen), agent.draws, 3), dtype=np.float32))
        logp = np.stack([decision.sampled_logp for decision in decisions])
        choices = np.stack([decision.sampled for decision in decisions])
        sampled = SampledActions(choices=choices, logp=logp, rewards=np.zeros_like(logp))
        done.append(replace(t, sampled=sampled, reward_version=0))
    return done


def _iteration(learner: Any, rollouts: list[Any], config: Config, asks: bool) -> dict[str, float]:
    """CPU seconds of each part. Rewards are the service's where the checkout can train on those alone."""
    marks = [time.process_time()]
    featurised = learner.featurise(rollouts)
    marks.append(time.process_time())
    learner.discriminator.update(learner.demos.sample(config.discriminator.batch), featurised, learner.policy.net)
    marks.append(time.process_time())
    rewards = learner.discriminator.rewards(featurised, version=1)
    marks.append(time.process_time())
    learner.policy.update(featurised, rewards, *([learner.discriminator.reward_fn] if asks else []))
    marks.append(time.process_time())
    names = ("featurise", "discriminator", "rewards", "policy")
    return {name: after - before for name, before, after in zip(names, marks, marks[1:], strict=False)}


def _cloning(learner: Any, config: Config) -> float:
    """CPU seconds a step of one cloning update."""
    expert = learner.demos.sample(config.cloning.batch)
    since_s = time.process_time()
    learner.cloner.update(expert)
    return (time.process_time() - since_s) / sum(len(example.features) for example in expert)


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1] == "mix", int(sys.argv[2]), Path(sys.argv[3]))))  # noqa: T201
