"""Where the learner computes: its device, and its number of threads on the CPU."""

from __future__ import annotations

import os

import torch

from giirl_core.config import Config

CORES_PER_ACTOR = 2  # for the actor process and its Chrome


def learner_device(config: Config) -> torch.device:
    """The device of `learner.device`. ValueError if that is "cuda" and there is no CUDA device."""
    wanted, has_cuda = config.learner.device, torch.cuda.is_available()
    if wanted == "cuda" and not has_cuda:
        raise ValueError("learner.device is 'cuda', but torch finds no CUDA device here: wanted 'cpu' or 'auto'")
    if wanted == "cpu" or not has_cuda or (wanted == "auto" and config.runtime == "serial"):
        return torch.device("cpu")
    return torch.device("cuda")


def device_memory_bytes() -> int:
    """Memory that tensors of this process use on its CUDA device; 0 without one."""
    return torch.cuda.memory_allocated() if torch.cuda.is_available() else 0


def learner_threads(config: Config) -> int:
    """The number of CPU threads of the learner.

    The `serial` runtime has one thread: with more, floating-point sums would depend on the machine.
    """
    if config.learner.threads:
        return config.learner.threads
    cores = len(os.sched_getaffinity(0))
    if config.runtime == "serial":
        return 1
    return cores if config.runtime == "ray" else max(1, cores - CORES_PER_ACTOR * config.actors.count)
