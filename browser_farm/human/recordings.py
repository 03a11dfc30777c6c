"""Imports public human recordings of MiniWoB tasks as trajectories, and counts the reasons for those it skips.

The recordings are from Liu, Guu, Pasupat, Shi and Liang, Reinforcement Learning on Web Interfaces Using Workflow-Guided
Exploration, 2018.
"""

from __future__ import annotations

import difflib
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from browser_farm.human.action_inference import infer_actions
from browser_farm.human.gesture_context import InferredAction
from browser_farm.human.gestures import RecordedState, UnsupportedRecording
from browser_farm.human.recorded_pages import parse_node, read_number
from browser_farm.human.recording_files import find_recordings, name_of, read_json
from browser_farm.human.spans import equivalent_span
from giirl_core.types import DEMONSTRATION, NO_SPAN, Action, Episode, Goal, Outcome, Trajectory, Verb

FAILED = "failed"
DUPLICATE = "duplicate"
UNREADABLE = "unreadable"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedRecording:
    """The content of one file. An episode that is not clean is a failed one."""

    episode: Episode | None
    clean: bool  # a successful demonstration that policies can imitate
    reason: str  # why it is not clean, "" if it is


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskImport:
    """Counts the recordings of one task: files = clean + failures + sum of skipped + unread."""

    files: int
    clean: int
    failures: int  # imported; their outcome marks them
    skipped: Mapping[str, int] = field(default_factory=dict)  # reason -> files
    unread: int = 0  # not read, because the limit was reached
    unreadable: tuple[str, ...] = ()  # for each file that is not a recording: its path, and why not


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportReport:
    """Counts the recordings of all requested tasks."""

    tasks: Mapping[str, TaskImport]

    def lines(self) -> list[str]:
        """A text table, one line per task."""
        width = max([4, *map(len, self.tasks)])
        rows = [f"{'task':{width}}  files  clean  failures  unread  skipped"]
        for task, count in self.tasks.items():
            reasons = ", ".join(f"{number} {reason}" for reason, number in sorted(count.skipped.items()))
            numbers = f"{count.files:5}  {count.clean:5}  {count.failures:8}  {count.unread:6}"
            rows.append(f"{task:{width}}  {numbers}  {reasons}".rstrip())
        return rows

    @property
    def unreadable(self) -> list[str]:
        """For each file that is not a recording: its path, and why not."""
        return [line for count in self.tasks.values() for line in count.unreadable]

    def summary(self) -> dict[str, object]:
        """The counts as JSON values: totals, and each task."""
        counts = self.tasks.values()
        return {
            "files": sum(count.files for count in counts),
            "clean": sum(count.clean for count in counts),
            "failures": sum(count.failures for count in counts),
            "tasks": {task: {**asdict(count), "skipped": dict(count.skipped)} for task, count in self.tasks.items()},
        }


def read_recording(path: Path) -> ImportedRecording:
    """Read one recording. Its task is the name of its folder. ValueError if the file is not a recording."""
    try:
        recording = _parse(read_json(path))
    except RecursionError as error:
        raise ValueError(f"{path} is not a recording: nested too deep, wanted a recorded episode") from error
    except ValueError as error:
        raise ValueError(f"{path} is not a recording: {error}") from error
    failed = recording.raw_reward < 1.0
    if not recording.states:
        return ImportedRecording(episode=None, clean=False, reason="empty")
    try:
        actions = infer_actions(recording.states, strict=not failed)
        episode = _episode(path, recording, actions, strict=not failed)
    except UnsupportedRecording as unsupported:
        return ImportedRecording(episode=None, clean=False, reason=str(unsupported))
    return ImportedRecording(episode=episode, clean=not failed, reason=FAILED if failed else "")


def import_recordings(
    root: Path,
    *,
    tasks: Sequence[str],
    limit: int | None = None,
    collections: Sequence[str] | None = None,
    on_file: Callable[[], None] = lambda: None,
) -> tuple[list[Episode], ImportReport]:
    """Read the recordings of some tasks, in the order of `tasks` and of the file names.

    `root` is the folder of all collections, of one collection, or of one task of a collection. After `limit` clean
    recordings of a task, its other files are not read. The returned episodes include failed ones; their outcome marks
    them. A recording that is in two collections is imported once. A file that is not a recording is left out and named
    in the report. `on_file` is called for each file read. ValueError for an unknown task or collection, or a folder
    without recordings.
    """
    if limit is not None and limit < 1:
        raise ValueError(f"limit is {limit}, wanted at least 1")
    recordings = find_recordings(root, collections=collections)
    episodes: list[Episode] = []
    counts: dict[str, TaskImport] = {}
    for task in tasks:
        if task not in recordings:
            near = difflib.get_close_matches(task, recordings, n=3, cutoff=0.4) or sorted(recordings)
            raise ValueError(f"{root} has no recordings of {task!r}, wanted one of: {', '.join(near)}")
        if task not in counts:
            imported, counts[task] = _import_task(recordings[task], limit, on_file)
            episodes.extend(imported)
    return episodes, ImportReport(tasks=counts)


def _import_task(
    paths: Sequence[Path], limit: int | None, on_file: Callable[[], None]
) -> tuple[list[Episode], TaskImport]:
    episodes: list[Episode] = []
    skipped: Counter[str] = Counter()
    names: set[str] = set()
    unreadable: list[str] = []
    clean = failures = read = 0
    for path in paths:
        if clean == limit:
            break
        read += 1
        on_file()
        if name_of(path) in names:
            skipped[DUPLICATE] += 1
            continue
        try:
            imported = read_recording(path)
        except ValueError as error:
            skipped[UNREADABLE] += 1
            unreadable.append(str(error))
            continue
        names.add(name_of(path))  # only now: another collection may have a sound copy
        if imported.episode is None:
            skipped[imported.reason] += 1
            continue
        episodes.append(imported.episode)
        clean += imported.clean
        failures += not imported.clean
    return episodes, TaskImport(
        files=len(paths),
        clean=clean,
        failures=failures,
        skipped=dict(skipped),
        unread=len(paths) - read,
        unreadable=tuple(unreadable),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recording:
    """The validated content of a file."""

    goal: Goal
    states: tuple[RecordedState, ...]
    raw_reward: float  # the page's reward without time decay


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
        raw_reward=read_number(raw, "rawReward", "the recording"),
    )


def _parse_state(raw: object, where: str) -> RecordedState:
    if not isinstance(raw, dict) or "dom" not in raw:
        raise ValueError(f"{where} has no dom, wanted an object with action and dom")
    action = raw.get("action")
    if action is None:
        action = {"type": "", "timing": 0}
    if not isinstance(action, dict):
        raise ValueError(f"{where}.action is a {type(action).__name__}, wanted an object or null")
    event = action.get("type")
    if not isinstance(event, str):
        raise ValueError(f"{where}.action.type is a {type(event).__name__}, wanted the name of a DOM event")
    return RecordedState(
        body=parse_node(raw["dom"], f"{where}.dom"),
        event=event,
        phase=int(read_number(action, "timing", where)),
        x=read_number(action, "x", where, 0),
        y=read_number(action, "y", where, 0),
        key_code=int(read_number(action, "keyCode", where, 0)),
    )


def _episode(path: Path, recording: _Recording, inferred: Sequence[InferredAction], *, strict: bool) -> Episode:
    tampered: set[int] = set()
    pages, actions = [], []
    for action in inferred:
        screen = recording.states[action.state].screen
        pages.append(screen.page(tampered))
        start, end = NO_SPAN, NO_SPAN
        if action.verb is Verb.TYPE:
            text = action.text
            start, end = equivalent_span(recording.goal, text) if strict else recording.goal.find(text)
            if strict and start == NO_SPAN:
                raise UnsupportedRecording("text not in instruction")
        actions.append(Action(verb=action.verb, element=action.row, start=start, end=end))
        tampered.add(screen.acted_ref(action.row))
    trajectory = Trajectory(
        task=path.absolute().parent.name,
        goal=recording.goal,
        seed=zlib.crc32(name_of(path).encode()),  # recordings store no page seed; this one is unique
        pages=tuple(pages),
        actions=tuple(actions),
        behaviour_logp=np.zeros(len(actions), dtype=np.float32),
        rewards=np.zeros(len(actions), dtype=np.float32),
        policy_version=DEMONSTRATION,
    )
    return Episode(trajectory=trajectory, outcome=Outcome(raw_reward=recording.raw_reward, ended=True))
