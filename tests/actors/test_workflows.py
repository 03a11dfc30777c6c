"""Workflows: what a step of a demonstration may be taken for, which actions it allows, and exploration with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from actors.agents import ExpertAgent
from actors.workflows import (
    Loosely,
    Workflow,
    WorkflowAgent,
    allowed_choices,
    read_workflow,
    read_workflows,
    workflow_of,
)
from browser_farm.experts import expert
from browser_farm.fake import FakeFarm
from giirl_core.choices import action_of
from giirl_core.gestures import BASIC, CLICK, TYPE_WORDS
from giirl_core.types import DEMONSTRATION, EpisodeSpec, Trajectory, Verb
from tests.actors.test_rollouts import episodes
from tests.learner.samples import policy, vectors


def demonstration(task: str, index: int = 0) -> Trajectory:
    """What the expert does on a page of the fake browser."""
    (played,) = episodes(FakeFarm(tabs=1), ExpertAgent(expert), 1, tasks=[task], first=index)
    return played.trajectory


def test_a_workflow_takes_a_step_for_its_text_its_kind_words_of_the_goal_and_anything() -> None:
    shown = demonstration("click-button")
    (step,) = workflow_of(shown, BASIC).steps
    page, row = shown.pages[0], shown.actions[0].element
    assert step == (
        Loosely(CLICK, "text", page.text[row]),
        Loosely(CLICK, "words"),
        Loosely(CLICK, "tag", page.tag[row]),
        Loosely(CLICK, "any"),
    )
    sizes = [len(allowed_choices(one, page, shown.goal, BASIC)) for one in step]
    assert sizes == sorted(sizes)
    assert sizes[-1] == page.leaf.sum()


def test_a_typed_text_in_quotes_is_taken_for_the_quoted_text_of_any_other_goal() -> None:
    shown, other = demonstration("enter-text"), demonstration("enter-text", 1)
    step = workflow_of(shown, BASIC).steps[0]
    quoted = next(one for one in step if one.where == "any" and one.quoted == 0)
    assert shown.goal != other.goal
    (choice,) = allowed_choices(quoted, other.pages[0], other.goal, BASIC)
    assert action_of(choice, other.pages[0], BASIC) == other.actions[0]
    words = len(other.goal.tokens)
    every = next(one for one in step if one.where == "any" and one.quoted < 0)
    assert len(allowed_choices(every, other.pages[0], other.goal, BASIC)) == words * (words + 1) / 2


@pytest.mark.parametrize("task", ["click-button", "enter-text"])
def test_every_meaning_of_a_step_allows_what_the_demonstration_did(task: str) -> None:
    shown = demonstration(task)
    steps = zip(workflow_of(shown, BASIC).steps, shown.pages, shown.choices(BASIC), strict=True)
    for loosely, page, choice in steps:
        for one in loosely:
            assert choice in allowed_choices(one, page, shown.goal, BASIC)


def test_workflows_are_read_back_and_a_bad_one_is_one_line() -> None:
    workflow = workflow_of(demonstration("enter-text"), BASIC)
    assert read_workflow(str(workflow)) == workflow
    assert read_workflows(["shown", str(workflow)]) == (workflow,)
    for bad in ("", "[]", '["t", [[["fly", "any"]]]]', '["t", [[["click"]]]]', '["t", 3]', "{}"):
        with pytest.raises(ValueError, match="is no workflow"):
            read_workflow(bad)


def test_a_workflow_with_a_gesture_that_the_policy_lacks_is_an_error() -> None:
    workflow = read_workflow('["click-menu", [[["hover", "any"]]]]')
    with pytest.raises(ValueError, match=r"gesture 'hover', which net\.gestures lacks"):
        WorkflowAgent(policy(), vectors(), [workflow])


def test_exploration_with_workflows_finds_what_the_policy_alone_does_not() -> None:
    workflow = workflow_of(demonstration("enter-text"), BASIC)
    won = []
    for workflows in ((), (workflow,)):
        agent = WorkflowAgent(policy(), vectors(), workflows)
        played = episodes(FakeFarm(tabs=4), agent, 100, tasks=["enter-text"])
        assert all(one.trajectory.policy_version != DEMONSTRATION for one in played)
        won.append(sum(one.outcome.success for one in played))
    assert won[0] < 5 < won[1] < 60


def test_exploration_goes_on_where_a_page_does_not_change() -> None:
    (page,) = FakeFarm(tabs=1).reset({0: EpisodeSpec(task="enter-text", seed=1)}).values()
    twice = Workflow("enter-text", ((Loosely(CLICK, "tag", "button"),), (Loosely(TYPE_WORDS, "any"),)))
    agent = WorkflowAgent(policy(), vectors(), [twice])
    for seed in range(20):  # half of the episodes follow the workflow
        seen = [replace(page, episode=EpisodeSpec(task="enter-text", seed=seed), step=step) for step in (0, 1)]
        first, second = agent.select_actions(seen, np.zeros((2, 1, 3), dtype=np.float32))
        if first.logp == 0.0:  # the only button
            break
    assert (first.action.verb, second.action.verb) == (Verb.CLICK, Verb.TYPE)
