"""Reads public human recordings of MiniWoB tasks into trajectories, and says why where it cannot."""

from __future__ import annotations

import difflib
import gzip
import json
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from browser_farm.human.action_inference import Step, repair
from browser_farm.human.gestures import State, UnsupportedRecording
from browser_farm.human.recorded_pages import measure, parse_node
from browser_farm.human.spans import wording
from giirl_core.types import DEMONSTRATION, NO_SPAN, Action, Episode, Goal, Outcome, Trajectory, Verb

MOST_BYTES = 64 << 20  # unpacked; the largest public recording has 5 MB
SUFFIXES = (".json.gz", ".json")
GZIP_MAGIC = b"\x1f\x8b"
FAILED = "failed"
REPEATED = "repeated"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """What one file holds. Clean is fit to imitate; an episode that is not clean is a person's failure."""

    episode: Episode | None
    clean: bool
    reason: str  # why it is not clean, "" when it is


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskImport:
    """What became of the recordings of one task: files = clean + failures + all skipped + unread."""

    files: int
    clean: int
    failures: int  # kept, their outcome tells them apart
    skipped: Mapping[str, int] = field(default_factory=dict)  # reason -> files
    unread: int = 0  # left alone because the limit was reached


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportReport:
    """What became of all recordings asked for."""

    tasks: Mapping[str, TaskImport]

    def lines(self) -> list[str]:
        """A table for people, one line a task."""
        wide = max([4, *map(len, self.tasks)])
        rows = [f"{'task':{wide}}  files  clean  failures  unread  skipped"]
        for task, count in self.tasks.items():
            reasons = ", ".join(f"{number} {reason}" for reason, number in sorted(count.skipped.items()))
            numbers = f"{count.files:5}  {count.clean:5}  {count.failures:8}  {count.unread:6}"
            rows.append(f"{task:{wide}}  {numbers}  {reasons}".rstrip())
        return rows

    def summary(self) -> dict[str, object]:
        """The same for machines: totals, and every task."""
        counts = self.tasks.values()
        return {
            "files": sum(count.files for count in counts),
            "clean": sum(count.clean for count in counts),
            "failures": sum(count.failures for count in counts),
            "tasks": {task: {**asdict(count), "skipped": dict(count.skipped)} for task, count in self.tasks.items()},
        }


def read_recording(path: Path) -> Recorded:
    """Read one recording; its task is the name of its folder. ValueError when it is no recording."""
    try:
        recording = _parse(json.loads(_unpack(path), parse_constant=_refuse_constant))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no recording: not JSON ({error}), wanted a recorded episode") from error
    except RecursionError as error:
        raise ValueError(f"{path} is no recording: nested too deep, wanted a recorded episode") from error
    except ValueError as error:
        raise ValueError(f"{path} is no recording: {error}") from error
    failed = recording.raw_reward < 1.0
    if not recording.states:
        return Recorded(episode=None, clean=False, reason="empty")
    try:
        steps = repair(recording.states, strict=not failed)
        episode = _episode(path, recording, steps, strict=not failed)
    except UnsupportedRecording as unusable:
        return Recorded(episode=None, clean=False, reason=str(unusable))
    return Recorded(episode=episode, clean=not failed, reason=FAILED if failed else "")


def import_recordings(
    root: Path,
    *,
    tasks: Sequence[str],
    limit: int | None = None,
    collections: Sequence[str] | None = None,
    on_file: Callable[[], None] = lambda: None,
) -> tuple[list[Episode], ImportReport]:
    """Read the recordings of some tasks, in the order of `tasks` and of the file names.

    `root` is the folder of all collections, one collection, or one task of one collection. `limit` ends a
    task after that many clean recordings. The episodes are the clean ones and people's failures, which their
    outcome tells apart. A recording that lies in two collections is taken once. `on_file` hears of each file read.
    """
    if limit is not None and limit < 1:
        raise ValueError(f"limit is {limit}, wanted at least 1")
    found = find_recordings(root, collections=collections)
    episodes: list[Episode] = []
    counts: dict[str, TaskImport] = {}
    for task in tasks:
        if task not in found:
            near = difflib.get_close_matches(task, found, n=3, cutoff=0.4) or sorted(found)
            raise ValueError(f"{root} has no recordings of {task!r}, wanted one of: {', '.join(near)}")
        if task not in counts:
            kept, counts[task] = _import_task(found[task], limit, on_file)
            episodes.extend(kept)
    return episodes, ImportReport(tasks=counts)


def find_recordings(root: Path, *, collections: Sequence[str] | None = None) -> dict[str, list[Path]]:
    """Task -> its recordings, sorted by collection and name."""
    if not root.is_dir():
        raise ValueError(f"{root} is no folder, wanted one with recordings as COLLECTION/TASK/*.json.gz")
    root = root.resolve()
    paths = [
        path
        for depth in ("*", "*/*", "*/*/*")
        for path in root.glob(depth)
        if path.name.endswith(SUFFIXES) and path.is_file()
    ]
    there = {path.parent.parent.name for path in paths}
    for name in collections or ():
        if name not in there:
            raise ValueError(f"{root} has no collection {name!r}, wanted one of: {', '.join(sorted(there))}")
    found: dict[str, list[Path]] = {}
    for path in sorted(paths):
        if collections is None or path.parent.parent.name in collections:
            found.setdefault(path.parent.name, []).append(path)
    if not found:
        raise ValueError(f"{root} has no recordings, wanted files COLLECTION/TASK/*.json.gz below it")
    return dict(sorted(found.items()))


def _import_task(
    paths: Sequence[Path], limit: int | None, on_file: Callable[[], None]
) -> tuple[list[Episode], TaskImport]:
    kept: list[Episode] = []
    skipped: Counter[str] = Counter()
    names: set[str] = set()
    clean = failures = read = 0
    for path in paths:
        if clean == limit:
            break
        read += 1
        on_file()
        if _stem(path) in names:
            skipped[REPEATED] += 1
            continue
        names.add(_stem(path))
        recorded = read_recording(path)
        if recorded.episode is None:
            skipped[recorded.reason] += 1
            continue
        kept.append(recorded.episode)
        clean += recorded.clean
        failures += not recorded.clean
    unread = len(paths) - read
    return kept, TaskImport(files=len(paths), clean=clean, failures=failures, skipped=dict(skipped), unread=unread)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recording:
    """A file's content, checked."""

    goal: Goal
    states: tuple[State, ...]
    raw_reward: float  # the page's own, not scaled by time


def _unpack(path: Path) -> bytes:
    """The file's bytes, unpacked if they are gzip (the public ones are not all what their names say)."""
    try:
        with path.open("rb") as file:
            packed = file.read(2) == GZIP_MAGIC
            file.seek(0)
            if packed:
                with gzip.GzipFile(fileobj=file) as inner:
                    content = inner.read(MOST_BYTES + 1)
            else:
                content = file.read(MOST_BYTES + 1)
    except EOFError as error:
        raise ValueError("the gzip data is cut short, wanted a whole file") from error
    except (gzip.BadGzipFile, zlib.error) as error:
        raise ValueError(f"the gzip data is damaged ({error}), wanted a whole file") from error
    except OSError as error:
        raise ValueError(f"cannot be read ({error.strerror}), wanted a file") from error
    if len(content) > MOST_BYTES:
        raise ValueError(f"holds more than {MOST_BYTES >> 20} MB, wanted one recorded episode")
    return content


def _refuse_constant(name: str) -> float:
    raise ValueError(f"holds {name}, wanted ordinary numbers")


def _parse(raw: object) -> _Recording:
    if not isinstance(raw, dict):
        raise ValueError(f"is a {type(raw).__name__}, wanted an object with utterance, states and rawReward")
    missing = [key for key in ("utterance", "states", "rawReward") if key not in raw]
    if missing:
        raise ValueError(f"{', '.join(missing)} missing, wanted utterance, states and rawReward")
    utterance, states = raw["utterance"], raw["states"]
    if not isinstance(utterance, str):
        raise ValueError(f"utterance is a {type(utterance).__name__}, wanted text")
    if not isinstance(states, list):
        raise ValueError(f"states is a {type(states).__name__}, wanted a list")
    return _Recording(
        goal=Goal(" ".join(utterance.split())),
        states=tuple(_parse_state(state, f"states[{index}]") for index, state in enumerate(states)),
        raw_reward=measure(raw, "rawReward", "the recording"),
    )


def _parse_state(raw: object, where: str) -> State:
    if not isinstance(raw, dict) or "dom" not in raw:
        raise ValueError(f"{where} has no dom, wanted an object with action and dom")
    action = raw.get("action")
    if action is None:
        action = {"type": "", "timing": 0}
    if not isinstance(action, dict):
        raise ValueError(f"{where}.action is a {type(action).__name__}, wanted an object or null")
    kind = action.get("type")
    if not isinstance(kind, str):
        raise ValueError(f"{where}.action.type is a {type(kind).__name__}, wanted the name of a DOM event")
    return State(
        body=parse_node(raw["dom"], f"{where}.dom"),
        kind=kind,
        timing=int(measure(action, "timing", where)),
        x=measure(action, "x", where, 0),
        y=measure(action, "y", where, 0),
        code=int(measure(action, "keyCode", where, 0)),
    )


def _episode(path: Path, recording: _Recording, steps: Sequence[Step], *, strict: bool) -> Episode:
    tampered: set[int] = set()
    pages, actions = [], []
    for step in steps:
        screen = recording.states[step.state].screen
        pages.append(screen.page(tampered))
        start, end = NO_SPAN, NO_SPAN
        if step.verb is Verb.TYPE:
            start, end = wording(recording.goal, step.text) if strict else recording.goal.find(step.text)
            if strict and start == NO_SPAN:
                raise UnsupportedRecording("text not in instruction")
        actions.append(Action(verb=step.verb, element=step.row, start=start, end=end))
        tampered.add(screen.touched(step.row))
    trajectory = Trajectory(
        task=path.resolve().parent.name,
        goal=recording.goal,
        seed=zlib.crc32(_stem(path).encode()),  # recordings do not know their seed; this tells them apart
        pages=tuple(pages),
        actions=tuple(actions),
        behaviour_logp=np.zeros(len(steps), dtype=np.float32),
        rewards=np.zeros(len(steps), dtype=np.float32),
        policy_version=DEMONSTRATION,
    )
    return Episode(trajectory=trajectory, outcome=Outcome(raw_reward=recording.raw_reward, ended=True))


def _stem(path: Path) -> str:
    """The file's name without its ending: the same for every copy of a recording."""
    return next(path.name.removesuffix(suffix) for suffix in SUFFIXES if path.name.endswith(suffix))
