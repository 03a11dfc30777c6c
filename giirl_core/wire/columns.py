"""Trajectories in columnar form: one flat array for each quantity, concatenated over trajectories, steps and rows.

    column                                 length      one entry for each
    steps, samples                         N           trajectory: its number of steps, of sampled actions for each
    rows, verb, element, ..., rewards      sum(steps)  step; `rows` is the number of elements of its page
    tag, text, ..., ref, box, ...          sum(rows)   element of a page
    sampled, sampled_logp, ...             sum(steps * samples)  sampled action
    characters                             -           all distinct strings, joined, in UTF-8
    string_ends                            S           distinct string: where it ends, in characters

Every distinct string is stored once; a text column holds the index of the string. The fields that a trajectory has once
(task, goal, ...) are not in the columns but in a header, see `header_fields`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from giirl_core.choices import SampledActions
from giirl_core.types import Action, Goal, Page, Trajectory, Verb

Column: TypeAlias = NDArray[Any]
Columns: TypeAlias = dict[str, Column]
T = TypeVar("T")

TEXT_COLUMNS = ("tag", "text", "value", "classes", "colour", "shape", "attributes")
# Name -> dtype and shape of one entry.
PER_TRAJECTORY: dict[str, tuple[str, tuple[int, ...]]] = {"steps": ("<u4", ()), "samples": ("<u4", ())}
PER_STEP: dict[str, tuple[str, tuple[int, ...]]] = {
    "rows": ("<u4", ()),
    "verb": ("|i1", ()),
    "element": ("<i4", ()),
    "start": ("<i4", ()),
    "end": ("<i4", ()),
    "to": ("<i4", ()),
    "at": ("<f8", (2,)),
    "by": ("<f8", (2,)),
    "literal": ("<u4", ()),
    "behaviour_logp": ("<f4", ()),
    "rewards": ("<f4", ()),
}
PER_ROW: dict[str, tuple[str, tuple[int, ...]]] = {
    **dict.fromkeys(TEXT_COLUMNS, ("<u4", ())),
    "ref": ("<i4", ()),
    "parent": ("<i2", ()),
    "box": ("<f4", (4,)),
    "focused": ("|b1", ()),
    "tampered": ("|b1", ()),
}
PER_SAMPLE = {"sampled": ("<i2", (4,)), "sampled_logp": ("<f4", ()), "sampled_rewards": ("<f4", ())}
STRINGS: dict[str, tuple[str, tuple[int, ...]]] = {"characters": ("|u1", ()), "string_ends": ("<u4", ())}
MAX_SAMPLES = 1024  # actions for each step
MAX_STEPS = 1 << 16  # in one set of columns; the unpacked objects of a step are many times larger than its columns
COLUMN_TYPES = {**PER_TRAJECTORY, **PER_STEP, **PER_ROW, **PER_SAMPLE, **STRINGS}


def pack(trajectories: Sequence[Trajectory]) -> Columns:
    """The columns of some trajectories. Raises ValueError when a number is not finite or there are too many steps."""
    pages = [page for trajectory in trajectories for page in trajectory.pages]
    actions = [action for trajectory in trajectories for action in trajectory.actions]
    columns: Columns = {
        "steps": _column("steps", [len(trajectory) for trajectory in trajectories]),
        "rows": _column("rows", [len(page) for page in pages]),
        "verb": _column("verb", [action.verb for action in actions]),
        "element": _column("element", [action.element for action in actions]),
        "start": _column("start", [action.start for action in actions]),
        "end": _column("end", [action.end for action in actions]),
        "to": _column("to", [action.to for action in actions]),
        "at": _column("at", [action.at for action in actions]).reshape(-1, 2),
        "by": _column("by", [action.by for action in actions]).reshape(-1, 2),
        "behaviour_logp": _concatenate("behaviour_logp", [t.behaviour_logp for t in trajectories]),
        "rewards": _concatenate("rewards", [t.rewards for t in trajectories]),
        **_pack_sampled([t.sampled for t in trajectories]),
    }
    for name in ("ref", "parent", "box", "focused", "tampered"):
        columns[name] = _concatenate(name, [getattr(page, name) for page in pages])
    columns |= _pack_strings(pages, actions)
    _check_shapes(columns)
    _check_finite(columns)
    return columns


def unpack(columns: Mapping[str, Column], headers: Sequence[Mapping[str, object]]) -> list[Trajectory]:
    """The inverse of `pack`; `headers` holds the `header_fields` of each trajectory. Arrays are views of the columns.

    The columns may come from an untrusted peer: every length and index is checked before it is used. Raises ValueError
    when anything is inconsistent.
    """
    _check_shapes(columns)
    _check_finite(columns)
    step_ends = _ends("steps", columns, count=len(headers), total=len(columns["rows"]), unit="steps")
    strings = _unpack_strings(columns)
    actions = _unpack_actions(columns, strings)
    pages = _unpack_pages(columns, strings)
    sampled = _unpack_sampled(columns)
    return [
        Trajectory(
            task=read_field(header, "task", str),
            goal=Goal(read_field(header, "goal", str)),
            seed=read_field(header, "seed", int),
            pages=tuple(pages[first:last]),
            actions=tuple(actions[first:last]),
            behaviour_logp=columns["behaviour_logp"][first:last].view(np.float32),
            rewards=columns["rewards"][first:last].view(np.float32),
            policy_version=read_field(header, "policy_version", int),
            reward_version=read_field(header, "reward_version", int),
            sampled=samples,
        )
        for header, (first, last), samples in zip(headers, _spans(step_ends), sampled, strict=True)
    ]


def header_fields(trajectory: Trajectory) -> dict[str, object]:
    """The fields that a trajectory has once, for a message header."""
    return {
        "task": trajectory.task,
        "goal": trajectory.goal.utterance,
        "seed": trajectory.seed,
        "policy_version": trajectory.policy_version,
        "reward_version": trajectory.reward_version,
    }


def read_field(header: Mapping[str, object], name: str, kind: type[T]) -> T:
    """The value of a header field. Raises ValueError when it is missing or its type is not exactly `kind`."""
    value = header.get(name)
    if type(value) is not kind:  # not isinstance: True is not a version number
        raise ValueError(f"header field {name!r} is {value!r:.80}, wanted {kind.__name__}")
    return value


def read_vectors(columns: Mapping[str, Column], dtypes: Mapping[str, str]) -> list[Column]:
    """The one-dimensional columns that `dtypes` names, in its order. Raises ValueError when there are any others."""
    if columns.keys() != dtypes.keys():
        raise ValueError(f"columns are {sorted(columns)!r:.80}, wanted {sorted(dtypes)}")
    for name, dtype in dtypes.items():
        if columns[name].dtype != np.dtype(dtype) or columns[name].ndim != 1:
            raise ValueError(f"column {name!r} is {columns[name].dtype}{list(columns[name].shape)}, wanted {dtype}[n]")
    return [columns[name] for name in dtypes]


def _column(name: str, values: Sequence[int | tuple[float, float]]) -> Column:
    return np.array(values, dtype=np.dtype(COLUMN_TYPES[name][0]))


def _concatenate(name: str, parts: Sequence[Column]) -> Column:
    dtype, entry = COLUMN_TYPES[name]
    if not parts:
        return np.empty((0, *entry), dtype=dtype)
    return np.concatenate(parts, dtype=np.dtype(dtype), casting="same_kind")


def _pack_sampled(parts: Sequence[SampledActions | None]) -> Columns:
    some = [part for part in parts if part is not None]
    return {
        "samples": _column("samples", [part.logp.shape[1] if part is not None else 0 for part in parts]),
        "sampled": _concatenate("sampled", [part.choices.reshape(-1, 4) for part in some]),
        "sampled_logp": _concatenate("sampled_logp", [part.logp.ravel() for part in some]),
        "sampled_rewards": _concatenate("sampled_rewards", [part.rewards.ravel() for part in some]),
    }


def _unpack_sampled(columns: Mapping[str, Column]) -> list[SampledActions | None]:
    steps, samples = columns["steps"].astype(np.int64), columns["samples"].astype(np.int64)
    ends, total = np.cumsum(steps * samples), len(columns["sampled"])
    if np.any(samples > MAX_SAMPLES) or (int(ends[-1]) if len(ends) else 0) != total:
        raise ValueError(f"column 'samples' splits {total} actions into {samples.tolist()[:8]} a step")
    return [
        SampledActions(
            choices=columns["sampled"][first:last].view(np.int16).reshape(count, wide, 4),
            logp=columns["sampled_logp"][first:last].view(np.float32).reshape(count, wide),
            rewards=columns["sampled_rewards"][first:last].view(np.float32).reshape(count, wide),
        )
        if wide
        else None
        for count, wide, (first, last) in zip(steps.tolist(), samples.tolist(), _spans(ends), strict=True)
    ]


def _pack_strings(pages: Sequence[Page], actions: Sequence[Action]) -> Columns:
    indices: dict[str, int] = {}
    columns: Columns = {}
    for name in (*TEXT_COLUMNS, "literal"):
        if name == "literal":
            strings = [action.literal for action in actions]
        else:
            strings = list(chain.from_iterable(getattr(page, name) for page in pages))
        for string in dict.fromkeys(strings):
            indices.setdefault(string, len(indices))
        columns[name] = np.fromiter(map(indices.__getitem__, strings), dtype=np.dtype("<u4"), count=len(strings))
    # JavaScript strings, and therefore pages, may contain lone surrogates.
    blob = "".join(indices).encode("utf-8", "surrogatepass")
    columns["characters"] = np.frombuffer(blob, dtype=np.uint8)
    columns["string_ends"] = np.cumsum([len(string) for string in indices], dtype=np.int64).astype("<u4")
    return columns


def _unpack_strings(columns: Mapping[str, Column]) -> list[str]:
    blob = columns["characters"].tobytes().decode("utf-8", "surrogatepass")
    ends = columns["string_ends"].astype(np.int64)
    if np.any(np.diff(ends, prepend=0) < 0) or (ends[-1] if len(ends) else 0) != len(blob):
        raise ValueError(f"column 'string_ends' does not split the {len(blob)} characters into strings")
    return [blob[first:last] for first, last in _spans(ends)]


def _unpack_actions(columns: Mapping[str, Column], strings: Sequence[str]) -> list[Action]:
    verbs = columns["verb"]
    if len(verbs) and not bool(np.all(np.isin(verbs, list(Verb)))):
        raise ValueError(f"column 'verb' holds {int(verbs.max())}, wanted one of {[int(verb) for verb in Verb]}")
    literals = _lookup_strings("literal", columns, strings)
    rows = zip(*(columns[name].tolist() for name in ("verb", "element", "start", "end", "to", "at", "by")), strict=True)
    return [
        Action(
            verb=Verb(verb),
            element=element,
            start=start,
            end=end,
            to=to,
            at=(at[0], at[1]),
            by=(by[0], by[1]),
            literal=literal,
        )
        for (verb, element, start, end, to, at, by), literal in zip(rows, literals, strict=True)
    ]


def _lookup_strings(name: str, columns: Mapping[str, Column], strings: Sequence[str]) -> tuple[str, ...]:
    """The strings whose indices a column holds."""
    indices = columns[name]
    if len(indices) and int(indices.max()) >= len(strings):
        raise ValueError(f"column {name!r} holds string index {int(indices.max())}, there are {len(strings)} strings")
    table = np.array(strings, dtype=object)
    return tuple(table[indices].tolist())


def _unpack_pages(columns: Mapping[str, Column], strings: Sequence[str]) -> list[Page]:
    row_ends = _ends("rows", columns, count=len(columns["rows"]), total=len(columns["ref"]), unit="page rows")
    texts = {name: _lookup_strings(name, columns, strings) for name in TEXT_COLUMNS}
    if len(columns["parent"]) and int(columns["parent"].min()) < -1:
        raise ValueError(f"column 'parent' holds {int(columns['parent'].min())}, wanted -1 or a row")
    return [
        Page(
            tag=texts["tag"][first:last],
            text=texts["text"][first:last],
            value=texts["value"][first:last],
            classes=texts["classes"][first:last],
            colour=texts["colour"][first:last],
            shape=texts["shape"][first:last],
            attributes=texts["attributes"][first:last],
            ref=columns["ref"][first:last].view(np.int32),
            parent=columns["parent"][first:last].view(np.int16),
            box=columns["box"][first:last].view(np.float32),
            focused=columns["focused"][first:last].view(np.bool_),
            tampered=columns["tampered"][first:last].view(np.bool_),
        )
        for first, last in _spans(row_ends)
    ]


def _check_shapes(columns: Mapping[str, Column]) -> None:
    if columns.keys() != COLUMN_TYPES.keys():
        different = sorted(columns.keys() ^ COLUMN_TYPES.keys())
        raise ValueError(f"columns {different} are missing or unknown")
    for name, (dtype, entry) in COLUMN_TYPES.items():
        column = columns[name]
        if column.dtype != np.dtype(dtype) or column.ndim == 0 or column.shape[1:] != entry:
            raise ValueError(f"column {name!r} is {column.dtype}{list(column.shape)}, wanted {dtype}[n, {entry}]")
    for group in (PER_TRAJECTORY, PER_STEP, PER_ROW, PER_SAMPLE):
        lengths = {name: len(columns[name]) for name in group}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns have lengths {lengths}, wanted equal lengths")
    rows = columns["rows"]
    if len(rows) > MAX_STEPS or (len(rows) and int(rows.min()) == 0):
        raise ValueError(f"got {len(rows)} steps or an empty page, wanted at most {MAX_STEPS} steps, each with a row")


def _check_finite(columns: Mapping[str, Column]) -> None:
    for name in ("behaviour_logp", "rewards", "box", "at", "by", "sampled_logp", "sampled_rewards"):
        if not bool(np.isfinite(columns[name]).all()):
            raise ValueError(f"column {name!r} holds a number that is not finite")


def _ends(name: str, columns: Mapping[str, Column], *, count: int, total: int, unit: str) -> NDArray[np.int64]:
    """The cumulated lengths of a column, which must be `count` and add up to `total`."""
    lengths = columns[name]
    ends = np.cumsum(lengths, dtype=np.int64)
    if len(lengths) != count or (int(ends[-1]) if len(ends) else 0) != total:
        raise ValueError(f"column {name!r} splits {total} {unit} into {lengths.tolist()[:8]}, wanted {count} parts")
    return ends


def _spans(ends: NDArray[np.int64]) -> Iterable[tuple[int, int]]:
    """(start, end) of consecutive parts, from where each ends."""
    stops = ends.tolist()
    return zip([0, *stops[:-1]], stops, strict=True) if stops else ()
