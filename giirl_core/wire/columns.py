"""Trajectories as columns: one flat array a quantity, so that no wire and no file carries lists of rows.

Step arrays are concatenated over trajectories and page rows over pages; `steps` and `rows` say how many
belong to each. Every string is kept once, in one UTF-8 blob, and rows name it by number.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import Action, Goal, Page, Trajectory, Verb

Column: TypeAlias = NDArray[Any]
Columns: TypeAlias = dict[str, Column]
T = TypeVar("T")

TEXTS = ("tag", "text", "value", "classes", "colour", "shape")
PER_TRAJECTORY: dict[str, tuple[str, tuple[int, ...]]] = {"steps": ("<u4", ())}
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
    **dict.fromkeys(TEXTS, ("<u4", ())),
    "ref": ("<i4", ()),
    "parent": ("<i2", ()),
    "box": ("<f4", (4,)),
    "focused": ("|b1", ()),
    "tampered": ("|b1", ()),
}
STRINGS: dict[str, tuple[str, tuple[int, ...]]] = {"characters": ("|u1", ()), "string_ends": ("<u4", ())}
MAX_STEPS = 1 << 16  # steps in one set of columns: each becomes objects many times its size
SCHEMA = {**PER_TRAJECTORY, **PER_STEP, **PER_ROW, **STRINGS}


def pack(trajectories: Sequence[Trajectory]) -> Columns:
    """The columns of some trajectories, without what each has once (see `head`)."""
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
        "behaviour_logp": _joined("behaviour_logp", [t.behaviour_logp for t in trajectories]),
        "rewards": _joined("rewards", [t.rewards for t in trajectories]),
    }
    for name in ("ref", "parent", "box", "focused", "tampered"):
        columns[name] = _joined(name, [getattr(page, name) for page in pages])
    columns |= _pack_strings(pages, actions)
    _check_shapes(columns)
    _check_finite(columns)
    return columns


def unpack(columns: Mapping[str, Column], heads: Sequence[Mapping[str, object]]) -> list[Trajectory]:
    """The inverse of `pack`; `heads` holds what each trajectory has once. Arrays are views of the columns.

    Anything inconsistent is a ValueError; no index is trusted before it was checked.
    """
    _check_shapes(columns)
    _check_finite(columns)
    step_ends = _ends("steps", columns, count=len(heads), total=len(columns["rows"]), of="steps")
    strings = _unpack_strings(columns)
    actions = _unpack_actions(columns, strings)
    pages = _unpack_pages(columns, strings)
    trajectories = []
    for head, (first, last) in zip(heads, _spans(step_ends), strict=True):
        trajectories.append(
            Trajectory(
                task=take(head, "task", str),
                goal=Goal(take(head, "goal", str)),
                seed=take(head, "seed", int),
                pages=tuple(pages[first:last]),
                actions=tuple(actions[first:last]),
                behaviour_logp=columns["behaviour_logp"][first:last].view(np.float32),
                rewards=columns["rewards"][first:last].view(np.float32),
                policy_version=take(head, "policy_version", int),
                reward_version=take(head, "reward_version", int),
            )
        )
    return trajectories


def head(trajectory: Trajectory) -> dict[str, object]:
    """What a trajectory has once."""
    return {
        "task": trajectory.task,
        "goal": trajectory.goal.utterance,
        "seed": trajectory.seed,
        "policy_version": trajectory.policy_version,
        "reward_version": trajectory.reward_version,
    }


def take(head: Mapping[str, object], name: str, kind: type[T]) -> T:
    """One field of a header, of exactly this type."""
    value = head.get(name)
    if type(value) is not kind:  # exactly: True is no version number
        raise ValueError(f"header field {name!r} is {value!r:.80}, wanted {kind.__name__}")
    return value


def flat(columns: Mapping[str, Column], dtypes: Mapping[str, str]) -> list[Column]:
    """Exactly these one-dimensional columns, in this order."""
    if columns.keys() != dtypes.keys():
        raise ValueError(f"columns are {sorted(columns)!r:.80}, wanted {sorted(dtypes)}")
    for name, dtype in dtypes.items():
        if columns[name].dtype != np.dtype(dtype) or columns[name].ndim != 1:
            raise ValueError(f"column {name!r} is {columns[name].dtype}{list(columns[name].shape)}, wanted {dtype}[n]")
    return [columns[name] for name in dtypes]


def _column(name: str, values: Sequence[int | tuple[float, float]]) -> Column:
    return np.array(values, dtype=np.dtype(SCHEMA[name][0]))


def _joined(name: str, parts: Sequence[Column]) -> Column:
    dtype, tail = SCHEMA[name]
    if not parts:
        return np.empty((0, *tail), dtype=dtype)
    return np.concatenate(parts, dtype=np.dtype(dtype), casting="same_kind")


def _pack_strings(pages: Sequence[Page], actions: Sequence[Action]) -> Columns:
    numbers: dict[str, int] = {}
    columns: Columns = {}
    for name in (*TEXTS, "literal"):
        if name == "literal":
            strings = [action.literal for action in actions]
        else:
            strings = list(chain.from_iterable(getattr(page, name) for page in pages))
        for string in dict.fromkeys(strings):
            numbers.setdefault(string, len(numbers))
        columns[name] = np.fromiter(map(numbers.__getitem__, strings), dtype=np.dtype("<u4"), count=len(strings))
    # A page may hold half of a surrogate pair; JavaScript allows it, so it has to survive the trip.
    blob = "".join(numbers).encode("utf-8", "surrogatepass")
    columns["characters"] = np.frombuffer(blob, dtype=np.uint8)
    columns["string_ends"] = np.cumsum([len(string) for string in numbers], dtype=np.int64).astype("<u4")
    return columns


def _unpack_strings(columns: Mapping[str, Column]) -> list[str]:
    blob = columns["characters"].tobytes().decode("utf-8", "surrogatepass")
    ends = columns["string_ends"].astype(np.int64)
    if np.any(np.diff(ends, prepend=0) < 0) or (ends[-1] if len(ends) else 0) != len(blob):
        raise ValueError(f"string_ends does not cut the {len(blob)} characters there are into strings")
    return [blob[first:last] for first, last in _spans(ends)]


def _unpack_actions(columns: Mapping[str, Column], strings: Sequence[str]) -> list[Action]:
    verbs = columns["verb"]
    if len(verbs) and not bool(np.all(np.isin(verbs, list(Verb)))):
        raise ValueError(f"column 'verb' holds {int(verbs.max())}, wanted one of {[int(verb) for verb in Verb]}")
    literals = _named("literal", columns, strings)
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


def _named(name: str, columns: Mapping[str, Column], strings: Sequence[str]) -> tuple[str, ...]:
    """The strings that a column names by number."""
    numbers = columns[name]
    if len(numbers) and int(numbers.max()) >= len(strings):
        raise ValueError(f"column {name!r} names string {int(numbers.max())} of {len(strings)}")
    known = np.empty(len(strings), dtype=object)
    known[:] = strings
    return tuple(known[numbers].tolist())


def _unpack_pages(columns: Mapping[str, Column], strings: Sequence[str]) -> list[Page]:
    row_ends = _ends("rows", columns, count=len(columns["rows"]), total=len(columns["ref"]), of="page rows")
    texts = {name: _named(name, columns, strings) for name in TEXTS}
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
            ref=columns["ref"][first:last].view(np.int32),
            parent=columns["parent"][first:last].view(np.int16),
            box=columns["box"][first:last].view(np.float32),
            focused=columns["focused"][first:last].view(np.bool_),
            tampered=columns["tampered"][first:last].view(np.bool_),
        )
        for first, last in _spans(row_ends)
    ]


def _check_shapes(columns: Mapping[str, Column]) -> None:
    if columns.keys() != SCHEMA.keys():
        odd = sorted(columns.keys() ^ SCHEMA.keys())
        raise ValueError(f"columns {odd} are missing or unknown")
    for name, (dtype, tail) in SCHEMA.items():
        column = columns[name]
        if column.dtype != np.dtype(dtype) or column.ndim == 0 or column.shape[1:] != tail:
            raise ValueError(f"column {name!r} is {column.dtype}{list(column.shape)}, wanted {dtype}[n, {tail}]")
    for group in (PER_TRAJECTORY, PER_STEP, PER_ROW):
        lengths = {name: len(columns[name]) for name in group}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns of one length have several: {lengths}")
    rows = columns["rows"]
    if len(rows) > MAX_STEPS or (len(rows) and int(rows.min()) == 0):
        raise ValueError(f"{len(rows)} steps, or a page with no row; wanted {MAX_STEPS} steps at most, each with a row")


def _check_finite(columns: Mapping[str, Column]) -> None:
    for name in ("behaviour_logp", "rewards", "box", "at", "by"):
        if not bool(np.isfinite(columns[name]).all()):
            raise ValueError(f"column {name!r} holds a number that is not finite")


def _ends(name: str, columns: Mapping[str, Column], *, count: int, total: int, of: str) -> NDArray[np.int64]:
    lengths = columns[name]
    ends = np.cumsum(lengths, dtype=np.int64)
    if len(lengths) != count or (int(ends[-1]) if len(ends) else 0) != total:
        raise ValueError(f"column {name!r} cuts {total} {of} into {lengths.tolist()[:8]}, wanted {count} parts")
    return ends


def _spans(ends: NDArray[np.int64]) -> Iterable[tuple[int, int]]:
    stops = ends.tolist()
    return zip([0, *stops[:-1]], stops, strict=True) if stops else ()
