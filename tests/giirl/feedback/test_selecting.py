"""Which episodes people are asked about, and which window gets them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from giirl.feedback import selector
from giirl.feedback.desk import LEASE_S, LOW, Desk
from giirl.feedback.selector import CHOSEN, ROUND, Candidate, Selector, candidate_of, doubt
from giirl.report.element_rewards import EpisodeView
from giirl.report.inspector import Inspector
from giirl.run.folder import RunFolder
from giirl_core.types import Purpose
from giirl_core.wire.answers import RIGHT, read_answer
from tests.giirl.feedback.examples import clicking, typing
from tests.giirl.report.examples import scored
from tests.giirl.small import config, run


def test_the_doubt_of_a_step_is_the_larger_one_of_policy_and_reward() -> None:
    sure = scored(4.0, -4.0)  # the policy's log-probability is 0
    assert doubt(sure) == pytest.approx(1 / (1 + math.exp(8.0)))
    assert doubt(replace(sure, policy_logp=math.log(0.25))) == pytest.approx(0.75)
    assert doubt(scored(1.0, 1.0)) == pytest.approx(0.5)
    assert doubt(scored(-4.0, 4.0)) == pytest.approx(1 / (1 + math.exp(-8.0)))  # the reward prefers the other
    assert doubt(replace(scored(), policy_logp=math.log(0.5))) == pytest.approx(0.5)  # no learned reward


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "run"
    run(path)
    return path


def test_the_least_sure_episodes_of_a_round_are_chosen_and_one_at_random(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[Candidate] = []

    def watched(view: EpisodeView) -> Candidate:
        played.append(candidate_of(view))
        return played[-1]

    monkeypatch.setattr(selector, "candidate_of", watched)
    with Selector(RunFolder(small), config(small)) as some:
        chosen = some.choose(Event())
    assert len(played) == ROUND
    assert len(chosen) == CHOSEN
    ordered = sorted((max(one.doubts) for one in played), reverse=True)
    assert [max(one.doubts) for one in chosen[:-1]] == ordered[: CHOSEN - 1]
    assert len({one.key for one in chosen}) == CHOSEN


def test_their_pages_are_of_feedback_alone_and_an_answered_one_is_not_played_again(small: Path) -> None:
    folder = RunFolder(small)
    desk = Desk(folder.feedback)
    with Selector(folder, config(small)) as some:
        desk.offer(chosen := some.choose(Event()))
    assert {one.view.seed >> 48 for one in chosen} == {Purpose.FEEDBACK}
    first = desk.take("a")
    assert first is not None
    desk.answer(first.key)
    with Selector(folder, config(small)) as some:
        keys = {one.key for _ in range(3) for one in some.choose(Event())}
    assert first.key not in keys


def test_a_new_checkpoint_is_used_from_the_next_round_on(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, loaded = RunFolder(small), list[int]()
    checkpoints = sorted(folder.checkpoints.glob("step-*"))
    monkeypatch.setattr(RunFolder, "latest_checkpoint", lambda self: checkpoints[0])
    with Selector(folder, config(small)) as some:
        monkeypatch.setattr(Inspector, "load", lambda self, policy, reward: loaded.append(policy.version))
        monkeypatch.setattr(RunFolder, "latest_checkpoint", lambda self: checkpoints[-1])
        some.choose(Event())
        some.choose(Event())
    assert loaded == [4]


def test_pages_that_never_open_are_an_error_and_not_episodes(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: object, spec: object) -> object:
        raise RuntimeError("the page was lost")

    monkeypatch.setattr(Inspector, "episode", broken)
    with (
        Selector(RunFolder(small), config(small)) as some,
        pytest.raises(RuntimeError, match=f"none of {ROUND} pages could be played: the page was lost"),
    ):
        some.choose(Event())


def test_two_windows_get_different_episodes_and_each_keeps_its_own(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "feedback")
    desk.offer([clicking(1), clicking(2)])
    first, second = desk.take("a"), desk.take("b")
    assert first is not None
    assert second is not None
    assert first.key != second.key
    assert desk.take("a") is first
    assert desk.take("c") is None
    desk.answer(first.key)
    assert desk.take("a") is None
    assert desk.take("b") is second


def test_the_episode_of_a_window_that_was_closed_goes_to_another(tmp_path: Path) -> None:
    time_s = [0.0]
    desk = Desk(tmp_path / "feedback", now=lambda: time_s[0])
    desk.offer([clicking(1)])
    first = desk.take("closed")
    time_s[0] = LEASE_S
    assert desk.take("b") is None
    time_s[0] = LEASE_S + 1
    assert desk.take("b") is first


def test_an_answer_is_a_file_at_once_and_a_second_one_replaces_it(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "feedback")
    desk.offer([clicking(1)])
    one = desk.take("a")
    assert one is not None
    desk.answer(one.key)
    assert read_answer(tmp_path / "feedback" / one.key).wrong_from == RIGHT
    desk.answer(one.key, wrong_from=1)
    assert read_answer(tmp_path / "feedback" / one.key).wrong_from == 1
    assert desk.answers == 1


def test_what_is_no_answer_leaves_the_episode_with_its_window(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "feedback")
    desk.offer([typing()])
    one = desk.take("a")
    assert one is not None
    with pytest.raises(ValueError, match="types “Ada”"):
        desk.answer(one.key, wrong_from=1, right_for="Enter Bertram.")
    assert desk.take("a") is one
    assert desk.answers == 0
    with pytest.raises(LookupError):
        desk.answer("another.answer")


def test_a_skipped_episode_is_gone_and_more_are_wanted_when_few_wait(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "feedback")
    desk.offer([clicking(number) for number in range(LOW + 1)])
    assert not desk.wait_until_low(0)
    one = desk.take("a")
    assert one is not None
    assert not desk.wait_until_low(0)
    desk.skip(one.key)
    assert desk.take("a") is not one
    assert desk.wait_until_low(0)
