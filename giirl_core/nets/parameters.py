"""Nets and optimisers as bytes: safetensors, checksummed, loaded whole or not at all."""

from __future__ import annotations

import hashlib

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import nn

from giirl_core.types import Weights


def seal_net(net: nn.Module, version: int) -> Weights:
    """The net's parameters at one learner step."""
    return Weights.seal(version, safetensors.torch.save(net.state_dict()))


def load_net(net: nn.Module, weights: Weights) -> None:
    """Put `weights` into `net`; ValueError when they are corrupt or another net's, and then `net` is as before."""
    weights.check()
    try:
        state = safetensors.torch.load(weights.blob)
    except SafetensorError as error:
        raise ValueError(f"weights version {weights.version} are no safetensors: {error}") from None
    own = net.state_dict()
    for name in sorted(own.keys() | state.keys()):
        got = tuple(state[name].shape) if name in state else None
        wanted = tuple(own[name].shape) if name in own else None
        if got != wanted:
            raise ValueError(f"weights version {weights.version}: {name} has shape {got}, this net wants {wanted}")
    net.load_state_dict(state)


def hash_nets(*nets: nn.Module) -> str:
    """sha256 over all parameters, hex: equal for equal nets."""
    digest = hashlib.sha256()
    for net in nets:
        for name, tensor in sorted(net.state_dict().items()):
            digest.update(name.encode())
            digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()


def seal_optimiser(optimiser: torch.optim.Optimizer) -> bytes:
    """The moments of every parameter; learning rates and the like come from the config."""
    moments = optimiser.state_dict()["state"]
    blob: bytes = safetensors.torch.save(
        {f"{index}.{name}": tensor for index, parts in moments.items() for name, tensor in parts.items()}
    )
    return blob


def load_optimiser(optimiser: torch.optim.Optimizer, blob: bytes) -> None:
    """The inverse; ValueError when the moments are of parameters of other shapes."""
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for key, tensor in safetensors.torch.load(blob).items():
        index, name = key.split(".", 1)
        moments.setdefault(int(index), {})[name] = tensor
    state = optimiser.state_dict()
    shapes = [parameter.shape for group in optimiser.param_groups for parameter in group["params"]]
    for number, parts in moments.items():
        for part, tensor in parts.items():
            if tensor.ndim and tensor.shape != shapes[number]:
                raise ValueError(f"{part} of parameter {number} has shape {tensor.shape}, wanted {shapes[number]}")
    state["state"] = moments
    optimiser.load_state_dict(state)
