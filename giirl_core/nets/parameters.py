"""Serialisation of nets and optimisers as safetensors bytes. Loading checks all parameters before it changes any."""

from __future__ import annotations

import hashlib

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import nn

from giirl_core.weights import Weights


def serialise_net(net: nn.Module, version: int) -> Weights:
    """The parameters of a net as safetensors bytes, with a checksum. `version` is the learner step."""
    return Weights.with_digest(version, safetensors.torch.save(net.state_dict()))


def load_net(net: nn.Module, weights: Weights) -> None:
    """Load `weights` into `net`.

    Raises ValueError, and leaves `net` unchanged, when the weights are corrupt or of a net with other parameters.
    """
    weights.check()
    try:
        state = safetensors.torch.load(weights.blob)
    except SafetensorError as error:
        raise ValueError(f"weights version {weights.version} are not safetensors: {error}") from None
    own = net.state_dict()
    for name in sorted(own.keys() | state.keys()):
        got = tuple(state[name].shape) if name in state else None
        wanted = tuple(own[name].shape) if name in own else None
        if got != wanted:
            raise ValueError(f"weights version {weights.version}: {name} has shape {got}, wanted {wanted}")
    net.load_state_dict(state)


def hash_nets(*nets: nn.Module) -> str:
    """The sha256 of the names and values of all parameters, in hex."""
    digest = hashlib.sha256()
    for net in nets:
        for name, tensor in sorted(net.state_dict().items()):
            digest.update(name.encode())
            digest.update(tensor.cpu().numpy().tobytes())
    return digest.hexdigest()


def serialise_optimiser(optimiser: torch.optim.Optimizer) -> bytes:
    """The optimiser's state of each parameter (the moments of Adam), without the hyperparameters of the config."""
    moments = optimiser.state_dict()["state"]
    blob: bytes = safetensors.torch.save(
        {f"{index}.{name}": tensor for index, parts in moments.items() for name, tensor in parts.items()}
    )
    return blob


def load_optimiser(optimiser: torch.optim.Optimizer, blob: bytes) -> None:
    """The inverse of `serialise_optimiser`. Raises ValueError when a moment has another shape than its parameter."""
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
