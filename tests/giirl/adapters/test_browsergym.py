"""Observations of BrowserGym on MiniWoB pages, recorded and live, as pages and actions of this project."""

from __future__ import annotations

import gzip
import json
from typing import Any

import numpy as np
import pytest

from giirl.adapters.browsergym import SeenPage, read_observation, score_candidates
from giirl_core.types import Action, Verb
from tests.giirl.adapters.record_browsergym import COLUMNS, FIXTURE, KEPT, browsergym, columns
from tests.giirl.adapters.stand_ins import exported_reward

ROWS: list[dict[str, Any]] = json.loads(gzip.decompress(FIXTURE.read_bytes()))
SPACE_PX = 3.0  # width of the space at the end of a line, which only BrowserGym's box includes
BY_TASK = {row["task"]: row for row in ROWS}


def seen(task: str) -> SeenPage:
    return read_observation(BY_TASK[task]["observation"])


def bid(page: SeenPage, tag: str, text: str = "") -> str:
    """BrowserGym's name of the first element with this tag and text."""
    return next(
        b for b, t, x in zip(page.bids, page.page.tag, page.page.text, strict=True) if t == tag and text in ("", x)
    )


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['task']}-{row['seed']}")
def test_a_page_is_read_from_browsergym_as_the_farm_reads_it(row: dict[str, Any]) -> None:
    page = read_observation(row["observation"]).page
    found, wanted = columns(page), row["page"]
    for name in set(COLUMNS) - {"box", "focused"}:
        assert found[name] == wanted[name], name
    np.testing.assert_allclose(page.box, np.reshape(wanted["box"], (-1, 4)), atol=SPACE_PX)


def test_actions_of_browsergym_are_actions_of_the_nets() -> None:
    page = seen("enter-text")
    name = page.goal.tokens[page.goal.tokens.index('"') + 1]
    field, button = bid(page, "input_text"), bid(page, "button")
    rows = {b: row for row, b in enumerate(page.bids)}
    start, end = page.goal.find(name)
    assert page.action(f"click({button!r})") == Action(verb=Verb.CLICK, element=rows[button])
    wanted = Action(verb=Verb.TYPE, element=rows[field], start=start, end=end)
    assert page.action(f' fill("{field}", "{name}") ') == wanted
    unknown = [f"fill('{field}', 'other')", f"fill('{button}', '{name}')", "click('999')", "click('')", "noop()"]
    unknown += [f"click('{button}', button='right')", f"press('{field}', 'Enter')", "scroll(0, 100)", "click(12)"]
    assert [page.action(candidate) for candidate in unknown] == [None] * len(unknown)


def test_boxes_and_lists_are_checked_and_chosen_by_a_click() -> None:
    page = seen("click-checkboxes")
    box = bid(page, "input_checkbox")
    checked = page.action(f"check('{box}')")
    assert checked == page.action(f"click('{box}')") != None  # noqa: E711
    assert page.action(f"uncheck('{box}')") is None
    page = seen("choose-list")
    option = page.page.tag.index("option")
    chosen = page.action(f"select_option('{bid(page, 'select')}', '{page.page.text[option]}')")
    assert chosen == Action(verb=Verb.CLICK, element=option)


def test_elements_that_were_acted_on_and_the_one_with_the_focus_are_marked() -> None:
    observation = BY_TASK["login-user"]["observation"]
    plain = read_observation(observation)
    field = bid(plain, "input_text")
    page = read_observation({**observation, "focused_element_bid": field}, acted=[field], scale=0.5)
    assert page.page.tampered.tolist() == page.page.focused.tolist() == [b == field for b in page.bids]
    assert page.page.box.tolist() == (plain.page.box / 2).tolist()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dom_object": None}, "the observation has no dom_object"),
        ({"dom_object": {"strings": [], "documents": []}}, "dom_object is no DOM snapshot with a body"),
        ({"goal": ""}, "wanted at least one word"),
    ],
)
def test_an_observation_without_page_or_goal_is_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_observation({**ROWS[0]["observation"], **changes})


@pytest.mark.parametrize("text", ["", "click '12'", "click('1'); click('2')", "(" * 999, "12", "a.click('1')"])
def test_text_that_is_no_call_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"is no action: wanted one call, as in click\('12'\)"):
        seen("enter-text").action(text)


def test_candidates_have_the_rewards_of_their_actions(tmp_path: Any) -> None:
    reward = exported_reward(tmp_path / "reward")
    page, observation = seen("click-button"), BY_TASK["click-button"]["observation"]
    candidates = [f"click('{b}')" for b in page.bids if b]
    scores = score_candidates(reward, observation, ["noop()", *candidates])
    assert scores[0] is None
    actions = [action for candidate in candidates if (action := page.action(candidate))]
    assert scores[1:] == pytest.approx(reward.score_actions(page.page, actions, page.goal).tolist(), abs=1e-5)
    assert score_candidates(reward, observation, ["noop()"]) == [None]


@pytest.mark.chrome
@pytest.mark.slow
def test_browsergym_itself_performs_the_actions_that_are_read() -> None:
    pytest.importorskip("browsergym.miniwob")
    with browsergym("enter-text") as env:
        observation, _ = env.reset(seed=0)
        assert set(KEPT) <= set(observation)
        page = read_observation(observation)
        name = page.goal.tokens[page.goal.tokens.index('"') + 1]
        candidate = f"fill('{bid(page, 'input_text')}', '{name}')"
        action = page.action(candidate)
        assert action is not None
        observation, *_ = env.step(candidate)
        page = read_observation(observation)
        assert page.page.value[action.element] == name
        _, reward, terminated, *_ = env.step(f"click('{bid(page, 'button')}')")
        assert (reward, terminated) == (1.0, True)
