"""Measures of a learned reward: their arithmetic, and the command on a run in the fake browser."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from actors.agents import FurtherAttempt, RandomAgent
from giirl.analysis.reward_quality import Attempt, outcome_measures, ranks, step_measures, uses, verdict
from tests.command import Command
from tests.giirl.small import run
from tests.learner.samples import expert_episodes


def attempt(seed: int, won: bool, verdict: float, logp: float = 0.0) -> Attempt:
    return Attempt(task="click-test", seed=seed, won=won, verdict=verdict, logp=logp)


JUDGED = [  # called right: three, of which two are
    attempt(1, won=True, verdict=2.0),
    attempt(1, won=True, verdict=1.0),
    attempt(1, won=False, verdict=0.5),
    attempt(2, won=True, verdict=-0.5),
    attempt(2, won=False, verdict=-1.0),
    attempt(2, won=False, verdict=-2.0),
]


def test_verdicts_on_episodes_are_counted_against_those_of_the_page() -> None:
    found = outcome_measures(JUDGED)
    assert found["precision"] == found["recall"] == found["f1"] == pytest.approx(2 / 3, abs=1e-4)
    assert found["npv"] == pytest.approx(2 / 3, abs=1e-4)
    assert found["auc"] == pytest.approx(8 / 9, abs=1e-4)


def test_a_reward_abstains_between_two_thresholds() -> None:
    found = outcome_measures(
        [
            attempt(1, won=True, verdict=0.8),
            attempt(1, won=False, verdict=0.71),
            attempt(1, won=False, verdict=0.3),  # abstains
            attempt(1, won=True, verdict=-1.9),  # abstains
            attempt(1, won=False, verdict=-4.0),
            attempt(1, won=True, verdict=-2.1),
            attempt(1, won=False, verdict=-2.2),
        ]
    )
    assert found["sure"] == pytest.approx(5 / 7, abs=1e-4)
    assert found["sure_precision"] == 0.5
    assert found["sure_npv"] == pytest.approx(2 / 3, abs=1e-4)


def test_a_mistake_counts_less_the_more_steps_follow() -> None:
    assert verdict(np.array([0.5, 2.0, 1.0])) == 0.5
    assert verdict(np.array([1.0, -2.0])) == -2.0
    assert verdict(np.array([-2.0, 1.0, 3.0])) == pytest.approx(-2.0 * 0.36)
    assert verdict(np.array([-2.0, 1.0, -1.0])) == -1.0


def test_what_has_nothing_to_divide_by_is_none() -> None:
    found = outcome_measures([attempt(1, won=True, verdict=1.0)])
    assert (found["sure"], found["sure_precision"], found["sure_npv"]) == (1.0, 1.0, None)
    assert (found["precision"], found["recall"], found["npv"], found["auc"]) == (1.0, 1.0, None, None)
    assert outcome_measures([attempt(1, won=False, verdict=1.0)])["recall"] is None
    assert outcome_measures([])["episodes"] == 0


def test_a_step_is_ranked_among_the_first_four_other_actions_and_ties_count_against_it() -> None:
    same, other = False, True
    logits = np.array(
        [
            [3.0, 2.0, 1.0, 0.0, -1.0, 9.0],  # the fifth is not looked at
            [0.0, 0.0, 1.0, -1.0, -2.0, -3.0],  # a tie and a better one
            [0.0, 0.0, 1.0, 2.0, 3.0, 4.0],  # the first is the action itself
            [0.0, 1.0, 1.0, 1.0, 1.0, 1.0],  # too few others
        ],
        dtype=np.float32,
    )
    differs = np.array([[other] * 5, [other] * 5, [same, *[other] * 4], [same, same, *[other] * 3]])
    assert ranks(logits, differs) == [1, 3, 5]
    found = step_measures([1, 3, 5])
    assert found == {
        "steps": 3,
        "best_of_n": pytest.approx(1 / 3),
        "pairwise": pytest.approx(0.5),
        "mrr": pytest.approx((1 + 1 / 3 + 1 / 5) / 3),
    }
    assert step_measures([]) == {"steps": 0, "best_of_n": None, "pairwise": None, "mrr": None}


def test_the_preferred_attempt_is_compared_with_one_and_with_the_best() -> None:
    assert uses([*JUDGED[1:], attempt(2, won=True, verdict=-3.0, logp=-1.0), attempt(1, won=False, verdict=-9.0)]) == {
        "sampled": pytest.approx(3 / 7),
        "best_attempt": 1.0,
        "likeliest": 1.0,
        "oracle": 1.0,
    }
    assert uses([attempt(1, won=True, verdict=0.0), attempt(1, won=False, verdict=1.0)])["best_attempt"] == 0.0
    assert uses([attempt(1, won=True, verdict=1.0, logp=-2.0), attempt(1, won=False, verdict=0.0)])["likeliest"] == 0.0


def test_a_further_attempt_uses_other_random_numbers() -> None:
    again = FurtherAttempt(RandomAgent(), 2)
    assert again.draws == 3 * RandomAgent().draws
    trajectory = expert_episodes(1)[0].trajectory
    uniform = np.random.default_rng(0).random((1, again.draws, 3), dtype=np.float32)
    observation = type("Seen", (), {"page": trajectory.pages[0], "goal": trajectory.goal})()
    assert again.select_actions([observation], uniform) == RandomAgent().select_actions(
        [observation], uniform[:, 2 * RandomAgent().draws :]
    )


def test_the_command_measures_every_task_of_a_run(giirl: Command, tmp_path: Path) -> None:
    run(tmp_path / "run", "iterations=1")
    done = giirl(
        "reward", "measure", tmp_path / "run", "--pages", "3", "--attempts", "2", "--json", tmp_path / "q.json"
    )
    assert done.status == 0, done.error
    found = json.loads((tmp_path / "q.json").read_text(encoding="utf-8"))
    assert found["all"]["episodes"] == 3 * 2 * len(found["tasks"])
    for row in found["tasks"].values():
        assert row["pages"] == 3
        assert row["sampled"] <= row["oracle"]
        assert row["best_of_n"] is None or row["best_of_n"] <= row["mrr"] <= row["pairwise"] * 0.8 + 0.2
    assert "oracle" in done.out
    made_by = found["settings"]["reward"]
    assert (made_by["run"], made_by["version"]) == (str(tmp_path / "run"), 1)
    assert "iterations=1" in made_by["settings"]


def test_the_policy_of_another_run_plays_if_its_net_is_the_same(giirl: Command, tmp_path: Path) -> None:
    run(tmp_path / "run", "iterations=1")
    run(tmp_path / "other", "algorithm=cloning", "iterations=1", "seed=1")
    run(tmp_path / "wide", "algorithm=cloning", "iterations=1", "net.width=32")
    few = ("reward", "measure", tmp_path / "run", "--pages", "2", "--attempts", "1")
    own, other = tmp_path / "own.json", tmp_path / "other.json"
    assert giirl(*few, "--json", own).status == giirl(*few, "--policy", tmp_path / "other", "--json", other).status == 0
    first, second = (json.loads(file.read_text(encoding="utf-8")) for file in (own, other))
    assert first["tasks"] != second["tasks"]
    assert second["settings"]["policy"]["run"] == str(tmp_path / "other")
    refused = giirl(*few, "--policy", tmp_path / "wide")
    assert refused.status != 0
    assert "wanted a policy with the same net.width" in refused.error
