"""A policy plays one task: its choices, the candidates, the verdict, and when it refuses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from browser_farm.fake import FakeFarm
from giirl.report.play import CANDIDATES, Play, TooUncertain, candidates_table
from giirl.run.api import load_policy, load_reward
from giirl_core.types import Command, EpisodeSpec, Goal, Observation, StepResult
from tests.command import Command as GiirlCommand
from tests.giirl.small import run

SPEC = EpisodeSpec(task="click-button", seed=4)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("play") / "run"
    run(path, "seed=10")  # whose policy clicks first
    return path


class Watched(FakeFarm):
    """A fake browser that keeps its commands. From its `lost_at`-th step on it breaks."""

    def __init__(self, lost_at: int = 0) -> None:
        super().__init__(tabs=1)
        self.commands: list[Command] = []
        self._lost_at = lost_at

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        self.first = super().reset(episodes)
        return self.first

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        self.commands += commands.values()
        if len(self.commands) == self._lost_at:
            return {0: StepResult(raw_reward=0.0, done=False, observation=None, lost="page_hung")}
        return super().step(commands)


def play(path: Path, browser: Watched, *, goal: str = "", least: float = 0.0, reward: bool = True) -> Play:
    asked = Goal(goal) if goal else None
    return Play(
        browser, load_policy(path), load_reward(path) if reward else None, SPEC, step_limit=3, goal=asked, least=least
    )


def test_the_policy_acts_until_the_end_and_the_page_gives_the_verdict(trained: Path) -> None:
    browser = Watched()
    played = play(trained, browser)
    steps = list(played.steps())
    assert len(steps) == len(browser.commands)
    assert played.success is (played.result is not None and played.result.raw_reward == 1.0)
    assert played.verdict.startswith("succeeded: " if played.success else "failed: ")
    first = browser.first[0].page
    assert browser.commands[0].ref == int(first.ref[steps[0].chosen.action.element])


def test_a_step_has_the_best_action_on_each_of_the_best_elements_and_its_probability(trained: Path) -> None:
    played = play(trained, Watched())
    step = next(played.steps())
    rewards = [candidate.reward for candidate in step.best]
    assert rewards == sorted(rewards, key=lambda reward: -(reward or 0.0))
    assert len({candidate.action.element for candidate in step.best}) == len(step.best) <= CANDIDATES
    uniform = np.zeros((1, 1, 3), np.float32)
    observation = played.browser.reset({0: SPEC})[0]
    (decision,) = played.agent.select_actions([observation], uniform)
    assert step.chosen.action == decision.action
    assert step.chosen.probability == pytest.approx(np.exp(decision.logp), abs=1e-5)
    assert step.chosen.reward == pytest.approx(
        float(load_reward(trained).score_actions(observation.page, observation.goal, [decision.action])[0]), abs=1e-5
    )
    assert 0 < sum(candidate.probability for candidate in step.best) <= 1 + 1e-5


def test_without_a_learned_reward_the_most_probable_candidates_come_first(trained: Path) -> None:
    step = next(play(trained, Watched(), reward=False).steps())
    assert [candidate.reward for candidate in step.best] == [None] * len(step.best)
    assert step.best[0].probability == max(candidate.probability for candidate in step.best)
    assert step.best[0].action == step.chosen.action
    assert "-" in list(candidates_table(step).columns[2].cells)


def test_below_the_wanted_confidence_nothing_is_done(trained: Path) -> None:
    browser = Watched()
    played = play(trained, browser, least=1.0)
    with pytest.raises(TooUncertain, match=r"step 1, click .* has the probability 0.* wanted at least 1; it was not"):
        list(played.steps())
    assert browser.commands == []
    assert played.summary()["ended"] is False
    assert len(played.summary()["steps"]) == 1


def test_another_instruction_is_followed_on_the_same_page_and_has_no_verdict(trained: Path) -> None:
    browser = Watched()
    played = play(trained, browser, goal='Click on the "Cancel" button.')
    list(played.steps())
    summary = played.summary()
    assert (summary["goal"], summary["given_goal"], summary["success"]) == ('Click on the "Cancel" button.', True, None)
    assert browser.first[0].goal.utterance != played.instruction
    assert "no verdict, since it knows its own instruction only" in played.verdict


def test_a_page_that_breaks_is_one_line_and_no_failure(trained: Path) -> None:
    played = play(trained, Watched(lost_at=1))
    with pytest.raises(RuntimeError, match="click-button: step 1 broke the page or the browser: page_hung"):
        list(played.steps())
    assert played.success is None


def test_the_command_prints_each_step_and_writes_json(giirl: GiirlCommand, trained: Path, tmp_path: Path) -> None:
    answer = giirl("play", trained, "--task", "click-button", "--seed", "2", "--json", "play.json")
    assert answer.status == 0, answer.err
    result = json.loads((tmp_path / "play.json").read_text())
    assert answer.out.startswith(result["goal"])
    assert "step 1: click" in answer.out
    assert answer.out.rstrip().splitlines()[-1].startswith(("succeeded: ", "failed: "))
    assert result["steps"][0]["candidates"][0]["reward"] is not None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--task", "click-button", "--min-confidence", "1"], "it was not done"),
        (["--task", "click-buton"], "it has click-test"),
        (["--task", "click-button", "--goal", " "], "wanted at least one word"),
        (["--task", "click-button", "--show"], "there is no screen"),
        (["--task", "click-button", "--seed", "70000"], "run seed 70000 is out of range"),
    ],
)
def test_what_cannot_be_played_is_one_line(
    words: list[str], message: str, giirl: GiirlCommand, trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    answer = giirl("play", trained, *words)
    assert message in answer.error
    assert answer.status == 1
