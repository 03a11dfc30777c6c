"""The page fixture for benchmarks without a browser: expert and random episodes on 52 MiniWoB tasks.

    python -m benchmarks.pages

plays the episodes in Chrome again and overwrites the fixture.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from giirl_core.types import DEMONSTRATION, Action, Episode, Goal, Page, Purpose, Trajectory, Verb

FIXTURE = Path(__file__).parent / "fixtures" / "pages.json.gz"
TASKS = (
    "book-flight-nodelay",
    "choose-date-nodelay",
    "choose-list",
    "click-button",
    "click-button-sequence",
    "click-checkboxes",
    "click-checkboxes-large",
    "click-checkboxes-soft",
    "click-checkboxes-transfer",
    "click-collapsible-2-nodelay",
    "click-collapsible-nodelay",
    "click-color",
    "click-dialog",
    "click-dialog-2",
    "click-link",
    "click-option",
    "click-pie-nodelay",
    "click-shades",
    "click-shape",
    "click-tab",
    "click-tab-2",
    "click-tab-2-hard",
    "click-test",
    "click-test-2",
    "click-widget",
    "count-shape",
    "email-inbox",
    "email-inbox-forward-nl",
    "email-inbox-forward-nl-turk",
    "email-inbox-nl-turk",
    "enter-date",
    "enter-password",
    "enter-text",
    "enter-text-dynamic",
    "enter-time",
    "focus-text",
    "focus-text-2",
    "grid-coordinate",
    "guess-number",
    "identify-shape",
    "login-user",
    "login-user-popup",
    "multi-layouts",
    "multi-orderings",
    "navigate-tree",
    "search-engine",
    "social-media",
    "social-media-all",
    "social-media-some",
    "tic-tac-toe",
    "use-autocomplete-nodelay",
    "use-spinner",
)
DEMONSTRATIONS, ROLLOUTS = 6, 2  # episodes per task
SPARSE_TEXT, SPARSE_FLAGS = ("value", "classes", "colour", "shape"), ("focused", "tampered")  # stored without defaults


def load_fixture() -> tuple[list[Trajectory], list[Trajectory]]:
    """The demonstrations and the rollouts of the random policy."""
    content = json.loads(gzip.decompress(FIXTURE.read_bytes()))
    demonstrations = [_decode(episode, DEMONSTRATION) for episode in content["demonstrations"]]
    return demonstrations, [_decode(episode, 0) for episode in content["rollouts"]]


def _decode(episode: dict[str, Any], version: int) -> Trajectory:
    steps = episode["steps"]
    return Trajectory(
        task=episode["task"],
        goal=Goal(episode["goal"]),
        seed=episode["seed"],
        pages=tuple(_decode_page(step["page"]) for step in steps),
        actions=tuple(
            Action(verb=Verb(step["verb"]), element=step["element"], start=step["start"], end=step["end"])
            for step in steps
        ),
        behaviour_logp=np.array(episode["logp"], dtype=np.float32),
        rewards=np.zeros(len(steps), dtype=np.float32),
        policy_version=version,
    )


def _decode_page(stored: dict[str, Any]) -> Page:
    count = len(stored["tag"])
    flags: dict[str, Any] = {}
    for name in SPARSE_FLAGS:
        flags[name] = np.zeros(count, dtype=np.bool_)
        flags[name][stored.get(name, [])] = True
    texts: dict[str, Any] = {}
    for name in SPARSE_TEXT:
        texts[name] = tuple(stored.get(name, {}).get(str(row), "") for row in range(count))
    return Page(
        tag=tuple(stored["tag"]),
        text=tuple(stored["text"]),
        ref=np.arange(1, count + 1, dtype=np.int32),
        parent=np.array(stored["parent"], dtype=np.int16),
        box=np.array(stored["box"], dtype=np.float32).reshape(count, 4),
        **texts,
        **flags,
    )


def save_fixture(demonstrations: Sequence[Episode], rollouts: Sequence[Episode]) -> None:
    """Overwrite the fixture."""
    content = {
        "demonstrations": [_encode(e.trajectory) for e in demonstrations],
        "rollouts": [_encode(e.trajectory) for e in rollouts],
    }
    packed = json.dumps(content, separators=(",", ":")).encode()
    FIXTURE.write_bytes(gzip.compress(packed, 9, mtime=0))


def _encode(trajectory: Trajectory) -> dict[str, Any]:
    steps = zip(trajectory.pages, trajectory.actions, strict=True)
    return {
        "task": trajectory.task,
        "goal": trajectory.goal.utterance,
        "seed": trajectory.seed,
        "logp": [round(float(logp), 4) for logp in trajectory.behaviour_logp],
        "steps": [
            {"page": _encode_page(p), "verb": int(a.verb), "element": a.element, "start": a.start, "end": a.end}
            for p, a in steps
        ],
    }


def _encode_page(page: Page) -> dict[str, Any]:
    sparse: dict[str, Any] = {
        name: {row: text for row, text in enumerate(getattr(page, name)) if text} for name in SPARSE_TEXT
    }
    sparse |= {name: np.flatnonzero(getattr(page, name)).tolist() for name in SPARSE_FLAGS}
    box = [[round(float(px), 2) for px in row] for row in page.box]
    whole = {"tag": page.tag, "text": page.text, "parent": page.parent.tolist(), "box": box}
    return {**whole, **{name: entries for name, entries in sparse.items() if entries}}


def record() -> None:
    """Play the episodes in Chrome. Keeps expert episodes that succeed with actions that the nets can learn."""
    from actors.agents import ExpertAgent, RandomAgent
    from actors.browser import open_browser
    from actors.rollouts import play_pages
    from browser_farm.experts import EXPERTS, expert
    from giirl_core.config import Config
    from giirl_core.gestures import BASIC
    from giirl_core.metrics import Metrics

    config, metrics = Config(tasks=TASKS, step_limit=20), Metrics()
    browser = open_browser(config, metrics)
    try:
        known = [task for task in TASKS if task in EXPERTS]
        agent, purpose = ExpertAgent(expert), Purpose.DEMONSTRATE
        played = play_pages(config, browser, agent, purpose, DEMONSTRATIONS, metrics, tasks=known)
        rollouts = play_pages(config, browser, RandomAgent(), Purpose.TRAIN, ROLLOUTS, metrics)
    finally:
        browser.close()
    learnable = [e for e in played if e.outcome.success and not e.trajectory.unlearnable(BASIC)]
    save_fixture(learnable, rollouts)


if __name__ == "__main__":
    record()
