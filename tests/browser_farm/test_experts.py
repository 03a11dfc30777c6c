"""Scripted experts: what they do with a page they were never meant for, and that they succeed on their own."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from actors.agents import ExpertAgent
from actors.rollouts import Schedule, play
from browser_farm.experts import EXPERTS, NoAction, expert
from browser_farm.experts.games import play_for_the_win
from browser_farm.experts.page_view import PageView, expert_for
from browser_farm.farm import ChromeFarm
from browser_farm.tasks import tasks
from giirl.run.experts import GOOD
from giirl_core.metrics import Metrics
from giirl_core.types import Action, EpisodeSpec, Goal, Observation, Page, Purpose, Verb

RESULT = Path("benchmarks/results/experts.json")
TABLE = Path("docs/experts.md")
SHARES = 6  # of the tasks, so that none takes long on a busy machine
SOMETIMES_LOST = {"tic-tac-toe", "email-inbox-nl-turk", "email-inbox-forward-nl-turk"}


def observe(task: str, goal: str, *rows: tuple[str, str, str, int]) -> Observation:
    """A page with rows of (tag, text, classes, parent), whose fields hold their text."""
    tag, text, classes, parent = zip(*rows, strict=True)
    count = len(rows)
    page = Page(
        tag=tag,
        text=tuple("" if each.startswith("input") else words for each, words in zip(tag, text, strict=True)),
        value=tuple(words if each.startswith("input") else "" for each, words in zip(tag, text, strict=True)),
        classes=classes,
        ref=np.arange(1, count + 1, dtype=np.int32),
        parent=np.array(parent, dtype=np.int16),
        box=np.tile(np.array([0, 0, 10, 10], dtype=np.float32), (count, 1)),
        focused=np.zeros(count, dtype=np.bool_),
        tampered=np.zeros(count, dtype=np.bool_),
    )
    return Observation(episode=EpisodeSpec(task=task, seed=1), page=page, goal=Goal(goal))


def test_every_expert_plays_a_task_that_exists() -> None:
    assert set(EXPERTS) <= set(tasks())


def test_two_experts_for_one_task_are_refused() -> None:
    with pytest.raises(AssertionError, match="two experts for click-test"):
        expert_for("click-test")(lambda view: view.click(0))


def test_an_expert_that_finds_nothing_to_do_is_stuck_and_the_chooser_waits() -> None:
    seen = observe("click-button", 'Click on the "Ok" button.', ("button", "Cancel", "", -1))
    with pytest.raises(NoAction, match="nothing with tag 'button', text 'Ok'"):
        expert("click-button")(seen)
    (choice,) = ExpertAgent(expert)([seen], np.zeros((1, 3), dtype=np.float32))
    assert choice.action == Action(verb=Verb.WAIT)


def test_what_is_typed_is_a_span_of_the_instruction_where_it_has_one() -> None:
    view = PageView(observe("enter-text", 'Enter "Ada" now.', ("input_text", "", "", -1)))
    assert view.type(0, "Ada") == Action(verb=Verb.TYPE, element=0, start=2, end=2)
    assert view.type(0, "ADA") == Action(verb=Verb.TYPE, element=0, literal="ADA")


def test_a_field_that_holds_what_it_should_is_left_alone() -> None:
    view = PageView(observe("enter-text", "Enter a b.", ("input_text", "a", "", -1), ("input_text", "", "", -1)))
    assert view.fill({0: "a", 1: "b"}) == Action(verb=Verb.TYPE, element=1, start=2, end=2)
    assert view.fill({0: "a"}) is None


def test_rows_are_found_by_what_they_are_and_by_what_they_lie_in() -> None:
    rows = [("div", "", "one", -1), ("p", "a", "", 0), ("div", "", "two x", -1), ("p", "a", "", 2), ("t", "b", "", 3)]
    view = PageView(observe("click-test", "Click.", *rows))
    assert view.rows("p", "a") == [1, 3]
    assert view.rows("p", "a", inside=2) == [3]
    assert view.row(css_class="x") == 2
    assert (view.page.below(2), view.first_leaf(2), view.all_text(2)) == ([3, 4], 4, "a b")
    assert (view.ancestor(4, css_class="two"), view.ancestor(4, "p")) == (2, 3)
    with pytest.raises(ValueError, match="lies in no"):
        view.ancestor(4, css_class="one")


@pytest.mark.parametrize("number", range(10))
def test_a_number_is_guessed_in_four_guesses_from_the_last_answer_alone(number: int) -> None:
    answer, field = "Waiting for your guess...", ""
    for _ in range(4):
        page = [("div", answer, "", -1), ("input_number", field, "", -1), ("button", "Submit", "", -1)]
        action = expert("guess-number")(observe("guess-number", "Guess the number between 0-9.", *page))
        assert action.verb is Verb.TYPE
        field = action.text(Goal("Guess the number between 0-9."))
        if int(field) == number:
            return
        answer = f"The number is {'lower' if number < int(field) else 'higher'} than {field} ."
    pytest.fail(f"{number} was not guessed")


def test_a_winning_cell_is_taken_before_anything_else() -> None:
    marks = ("mark-x", "mark-x", "", "mark-o", "mark-o", "", "", "", "")
    cells = [("span", "", mark, 0 if i < 3 else 1 if i < 6 else 2) for i, mark in enumerate(marks)]
    rows = [("div", "", "ttt-row", -1)] * 3 + cells
    action = play_for_the_win(PageView(observe("tic-tac-toe", "Win.", *rows)))
    assert (action.verb, action.element) == (Verb.CLICK, 3 + 2)


def test_the_committed_result_is_of_these_experts_and_the_table_says_the_same() -> None:
    rows = json.loads(RESULT.read_text())["tasks"]
    assert set(rows) <= set(EXPERTS)
    assert {row["episodes"] for row in rows.values()} == {200}
    assert sum(row["success"] >= GOOD for row in rows.values()) >= 60
    assert {task for task, row in rows.items() if row["success"] < GOOD} <= SOMETIMES_LOST
    told = [line.split("|")[1:3] for line in TABLE.read_text().splitlines() if line.startswith("|")][2:]
    assert {task.strip(): success.strip() for task, success in told} == {
        task: f"{100 * rows[task]['success']:.1f}" if task in rows else "-" for task in EXPERTS
    }


@pytest.fixture(scope="module")
def farm() -> Iterator[ChromeFarm]:
    with ChromeFarm(tabs=8) as farm:
        yield farm


@pytest.mark.chrome
@pytest.mark.slow
@pytest.mark.parametrize("share", range(SHARES))
def test_every_expert_succeeds_on_real_pages(farm: ChromeFarm, share: int) -> None:
    mine = sorted(EXPERTS)[share::SHARES]
    won: Counter[str] = Counter()
    schedule = Schedule(mine, farm.tabs, purpose=Purpose.INSPECT, run_seed=2, quota=2)
    for finished in play(farm, ExpertAgent(expert), schedule, step_limit=100, metrics=Metrics()):
        won.update(episode.trajectory.task for episode in finished if episode.outcome.success)
    assert {task for task in mine if won[task] < 2} <= SOMETIMES_LOST
