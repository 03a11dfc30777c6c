"""Where the learner computes: its device, and how many threads on the CPU."""

from __future__ import annotations

import os

import torch

from giirl_core.config import Config

CORES_PER_ACTOR = 2  # an actor's Chrome and the actor itself


def learner_device(config: Config) -> torch.device:
    """The device of the settings; ValueError for a CUDA device that is not there."""
    wanted, there = config.learner.device, torch.cuda.is_available()
    if wanted == "cuda" and not there:
        raise ValueError("learner.device is 'cuda', but torch finds no CUDA device here: wanted 'cpu' or 'auto'")
    if wanted == "cpu" or not there or (wanted == "auto" and config.runtime == "serial"):
        return torch.device("cpu")
    return torch.device("cuda")


def learner_threads(config: Config) -> int:
    """Threads for the learner. `serial` has one: its sums must not depend on the machine."""
    if config.learner.threads:
        return config.learner.threads
    cores = len(os.sched_getaffinity(0))
    if config.runtime == "serial":
        return 1
    return cores if config.runtime == "ray" else max(1, cores - CORES_PER_ACTOR * config.actors.count)
