"""The reward r(s, a | g): the function that both the learner and the reward service use, the reward model, its file."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
import safetensors.torch
import torch
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from safetensors import SafetensorError, safe_open
from torch import Tensor
from torch.nn import functional

from giirl_core.config import Config, NetConfig
from giirl_core.config.sections import STRICT, PositiveFloat, RewardForm
from giirl_core.files import atomic_write
from giirl_core.nets.action_batch import (
    ActionBatch,
    choose,
    collate_candidates,
    collate_choices,
    collate_sampled,
    join,
)
from giirl_core.nets.batch import collate
from giirl_core.nets.features import Features, featurise
from giirl_core.nets.language import Vectors, load_vectors
from giirl_core.nets.models import PolicyNet, RewardNet
from giirl_core.nets.parameters import hash_nets, load_net
from giirl_core.types import UNSCORED, Action, Goal, Page, Trajectory
from giirl_core.weights import Weights

FORMS: tuple[str, ...] = get_args(RewardForm)
SCHEMA: Final = 4  # of exported rewards: raise it when the file, the nets or the features of a page change
HEADER = "giirl_reward"  # the key of the header in the metadata of the file


def reward_of(logit: Tensor, form: str, clip: float) -> Tensor:
    """The rewards for discriminator logits of any shape, which are clipped to [-clip, clip] first.

        form    reward                 source
        logit   log D - log(1 - D)     Luo 2019, Algorithm 1
        d       D                      Luo 2019, section 3.1
        log_d   log D
        gail    -log(1 - D)            Ho and Ermon 2016
        goal    1 if D > 1/2, else 0   AGILE, Bahdanau et al. 2019

    `logit`, `log_d` and `gail` are in nats, `d` is a probability. ValueError for another form.

    The end of an episode is worth 0, which is also the `logit` where D = 1/2. `d` and `gail` are never negative, so
    they reward stalling. `log_d` is never positive, so it rewards an early end. These three are for comparison.
    """
    logit = logit.clamp(-clip, clip)
    if form == "logit":
        return logit
    if form == "d":
        return torch.sigmoid(logit)
    if form == "log_d":
        return functional.logsigmoid(logit)
    if form == "gail":
        return functional.softplus(logit)
    if form == "goal":
        return (logit > 0).float()
    raise ValueError(f"there is no reward form {form!r}: wanted one of {', '.join(FORMS)}")


def episode_rewards(logits: Tensor, lengths: Sequence[int], form: str, clip: float) -> list[Tensor]:
    """The rewards [T, ...] of each episode, from the logits [sum T, ...] of all episodes with `lengths` T.

    The form `goal` rewards only the last step, because it judges whether the episode ended in a goal state.
    """
    rewards = reward_of(logits, form, clip)
    if form == "goal":
        last = torch.tensor(lengths).cumsum(0) - 1
        rewards = torch.zeros_like(rewards).index_copy(0, last, rewards[last])
    return list(rewards.split(list(lengths)))


class RewardModel:
    """A reward net with the form of its reward: computes rewards of pages, actions and trajectories.

    `version` is the learner step of its weights, -1 if it is untrained.
    """

    def __init__(self, net: RewardNet, vectors: Vectors, form: str, clip: float, version: int = UNSCORED) -> None:
        self.net, self.vectors, self.form, self.clip, self.version = net, vectors, form, clip, version

    @property
    def device(self) -> torch.device:
        """The device of the net."""
        return self.net.absent.device

    def score_pairs(self, pages: Sequence[Page], actions: Sequence[Action], goals: Sequence[Goal]) -> Tensor:
        """[B] rewards of B (page, action, goal) triples; ValueError for an action that is no gesture of the net."""
        rows = [featurise(page, goal, self.vectors) for page, goal in zip(pages, goals, strict=True)]
        choices = [choose(action, page, self.net.gestures) for action, page in zip(actions, pages, strict=True)]
        return reward_of(self._logits(rows, collate_choices(choices)).squeeze(1), self.form, self.clip)

    def score_actions(self, page: Page, goal: Goal, actions: Sequence[Action]) -> NDArray[np.float32]:
        """[M] rewards of M actions on one page, which is encoded only once; ValueError as in `score_pairs`."""
        candidates = collate_candidates([choose(action, page, self.net.gestures) for action in actions])
        logits = self._logits([featurise(page, goal, self.vectors)], candidates)
        return reward_of(logits.squeeze(0), self.form, self.clip).numpy()

    def score(self, trajectories: Sequence[Trajectory]) -> list[NDArray[np.float32]]:
        """The rewards [T * (1 + M)] of each trajectory, in the order that `Trajectory.with_rewards` expects.

        ValueError as in `score_pairs`, also for sampled actions.
        """
        taken = collate_choices([choice for t in trajectories for choice in t.choices(self.net.gestures)])
        rows = [featurise(page, t.goal, self.vectors) for t in trajectories for page in t.pages]
        logits = self._logits(rows, join(taken, collate_sampled(trajectories)[0]))
        lengths = [len(trajectory) for trajectory in trajectories]
        return [part.flatten().numpy() for part in episode_rewards(logits, lengths, self.form, self.clip)]

    @torch.no_grad()
    def _logits(self, rows: Sequence[Features], actions: ActionBatch) -> Tensor:
        """[B, M] logits of M actions on each of B pages, on the CPU."""
        self.net.eval()
        logits: Tensor = self.net(collate(rows).to(self.device), actions.to(self.device))
        return logits.cpu()


def build_reward(config: Config, weights: Weights | None = None) -> RewardModel:
    """The reward model for the settings of a run, with `weights`; untrained without them.

    ValueError if the weights are corrupt or of another net.
    """
    vectors = load_vectors(config.net.vectors)
    net = RewardNet(vectors, config.net)
    if weights is not None:
        load_net(net, weights)
    version = weights.version if weights is not None else UNSCORED
    return RewardModel(net, vectors, config.discriminator.reward, config.discriminator.clip, version)


def build_policy(config: Config) -> PolicyNet:
    """An untrained policy net for the settings of a run."""
    return PolicyNet(load_vectors(config.net.vectors), config.net)


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class RewardHeader:
    """What the file of an exported reward says besides the parameters of the net."""

    schema: Literal[4]  # SCHEMA
    version: int  # learner step of the weights
    net: NetConfig
    form: RewardForm
    clip: PositiveFloat  # nats
    vectors_version: str  # of the word vectors `net.vectors`
    sha256: str = ""  # of the parameters and of all above

    def digest(self, net: RewardNet) -> str:
        """What `sha256` has to be for the parameters of `net`."""
        text = _HEADER.dump_json(replace(self, sha256="")) + hash_nets(net).encode()
        return hashlib.sha256(text).hexdigest()


_HEADER = TypeAdapter(RewardHeader)


def export_reward(config: Config, weights: Weights, path: Path) -> None:
    """Write the reward of a run to one safetensors file, from which `import_reward` makes the same reward model.

    ValueError if the weights are corrupt or of another net.
    """
    model = build_reward(config, weights)
    header = RewardHeader(
        schema=SCHEMA,
        version=model.version,
        net=config.net,
        form=config.discriminator.reward,
        clip=model.clip,
        vectors_version=model.vectors.version,
    )
    text = _HEADER.dump_json(replace(header, sha256=header.digest(model.net))).decode()
    blob = safetensors.torch.save(model.net.state_dict(), {HEADER: text})
    with atomic_write(path) as file:
        file.write(blob)


def import_reward(path: Path) -> RewardModel:
    """The reward model of an exported file; ValueError, one line, for a damaged or a foreign one."""
    header, state = _read_export(path)
    if header.net.width > max((size for tensor in state.values() for size in tensor.shape), default=0):
        raise ValueError(f"{path} is damaged: its net has width {header.net.width}, and no parameter is as wide")
    vectors = load_vectors(header.net.vectors)
    if vectors.version != header.vectors_version:
        raise ValueError(
            f"{path} needs the word vectors {header.net.vectors!r} of version {header.vectors_version}, "
            f"here is version {vectors.version}"
        )
    net = RewardNet(vectors, header.net)
    try:
        load_net(net, Weights.with_digest(header.version, safetensors.torch.save(state)))
    except ValueError as error:
        raise ValueError(f"{path} is damaged: {error}") from None
    if (found := header.digest(net)) != header.sha256:
        raise ValueError(f"{path} is damaged: its content has sha256 {found[:12]}, wanted {header.sha256[:12]}")
    return RewardModel(net, vectors, header.form, header.clip, header.version)


def _read_export(path: Path) -> tuple[RewardHeader, dict[str, Tensor]]:
    if not path.is_file():
        raise ValueError(f"{path} is no exported reward: there is no such file")
    try:
        with safe_open(path, framework="pt") as file:
            text = (file.metadata() or {}).get(HEADER, "")
            if not text:
                raise ValueError(f"{path} is no exported reward: wanted a file of `giirl reward export`")
            names = file.keys()
            return _HEADER.validate_json(text), {name: file.get_tensor(name) for name in names}
    except SafetensorError as error:
        raise ValueError(f"{path} is no exported reward, or it is damaged: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "JSON"
        wanted = f"; this version of giirl reads schema {SCHEMA}" if key == "schema" else ""
        raise ValueError(f"{path}: its header has {key} = {first['input']!r:.40}: {first['msg']}{wanted}") from None
