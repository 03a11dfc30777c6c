"""CPU time of each part of an iteration of Algorithm 1 on the page fixture. A stand-alone program that prints JSON.

    python benchmarks/learner_parts.py four|mix ROUNDS FOLDER

`benchmarks.learner` runs it, and on another checkout the program there. FOLDER holds `pages.py`, so that both use the
same fixture. On checkouts from before this benchmark it runs this program; there the policy update takes a reward
function instead of sampled actions.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import resource
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
EPISODES = 32  # per iteration on the four tasks; on the mix there is one per task


def main(mix: bool, rounds: int, folder: Path) -> dict[str, Any]:
    """The median CPU time of each part of an iteration and of a cloning update per step, in ms, and the peak memory."""
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
    needs_reward_fn = "reward_fn" in inspect.signature(learner.policy.update).parameters
    if not needs_reward_fn:
        rollouts = _with_sampled(rollouts, learner, config.policy.sampled_actions)
    parts = [_iteration(learner, rollouts, config, needs_reward_fn) for _ in range(rounds + 1)][1:]
    cloning = [_cloning(learner, config) for _ in range(rounds + 1)][1:]
    ms = {name: 1e3 * statistics.median(part[name] for part in parts) for name in parts[0]}
    return {
        "episodes": len(rollouts),
        "steps": sum(map(len, rollouts)),
        "ms": {name: round(value, 2) for name, value in ms.items()},
        "cloning_ms_per_step": round(1e3 * statistics.median(cloning), 4),
        "memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
    }


def _fixture(folder: Path) -> tuple[list[Any], list[Any]]:
    """Demonstrations and rollouts from `pages.py` in `folder`."""
    spec = importlib.util.spec_from_file_location("pages", folder / "pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: tuple[list[Any], list[Any]] = module.load_fixture()
    return found


def _with_sampled(rollouts: list[Any], learner: Any, count: int) -> list[Any]:
    """The rollouts with `count` sampled actions per step, marked as scored by the reward service."""
    from actors.agents import PolicyAgent
    from giirl_core.choices import SampledActions
    from giirl_core.types import EpisodeSpec, Observation

    agent, rng = PolicyAgent(learner.policy.net, learner.vectors, sampled_actions=count), np.random.default_rng(0)
    done = []
    for t in rollouts:
        spec = EpisodeSpec(task=t.task, seed=t.seed)
        observations = [Observation(episode=spec, page=page, goal=t.goal) for page in t.pages]
        uniform = rng.random((len(observations), agent.draws, 3), dtype=np.float32)
        decisions: list[Any] = agent.select_actions(observations, uniform)
        logp = np.stack([decision.sampled_logp for decision in decisions])
        choices = np.stack([decision.sampled for decision in decisions])
        sampled = SampledActions(choices=choices, logp=logp, rewards=np.zeros_like(logp))
        done.append(replace(t, sampled=sampled, reward_version=0))
    return done


def _iteration(learner: Any, rollouts: list[Any], config: Config, needs_reward_fn: bool) -> dict[str, float]:
    """The CPU time of each part of one iteration, in seconds."""
    marks = [time.process_time()]
    featurised = learner.featurise(rollouts)
    marks.append(time.process_time())
    learner.discriminator.update(learner.demos.sample(config.discriminator.batch), featurised, learner.policy.net)
    marks.append(time.process_time())
    rewards = learner.discriminator.rewards(featurised, version=1)
    marks.append(time.process_time())
    learner.policy.update(featurised, rewards, *([learner.discriminator.reward_fn] if needs_reward_fn else []))
    marks.append(time.process_time())
    names = ("featurise", "discriminator", "rewards", "policy")
    return {name: after - before for name, before, after in zip(names, marks, marks[1:], strict=False)}


def _cloning(learner: Any, config: Config) -> float:
    """The CPU time of one cloning update per step, in seconds."""
    expert = learner.demos.sample(config.cloning.batch)
    since_s = time.process_time()
    learner.cloner.update(expert)
    return (time.process_time() - since_s) / sum(len(example.features) for example in expert)


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1] == "mix", int(sys.argv[2]), Path(sys.argv[3]))))  # noqa: T201
