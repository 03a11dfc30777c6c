"""What goes wrong with applications and browsers: one clear line, or one void episode."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from browser_farm.chrome import reaper
from giirl_core.types import Command, Verb
from tests.browser_farm.sites.player import Player, after, ref_of, row_of

pytestmark = pytest.mark.chrome


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("nowhere", r"unreachable http://127.0.0.1:4319/ cannot be opened: ERR_"),
        ("none", r"unreachable http://.*/no-such-page was answered with status 404"),
        ("missing", r"missing '#never' did not appear on http://.*/other within 0.5 s"),
        ("expired", r"login_expired the login has expired: the first page is http://.*/login"),
        ("away", r"refused http://.*/away leads to http://foreign.test/, whose origin is not among the allowed"),
        ("restless", r"not_quiet http://.*/restless was not quiet within 2 s: p#clock keeps changing"),
        ("poll", r"not_quiet http://.*/poll was not quiet within 2 s: requests are under way: http://.*/never"),
    ],
)
def test_a_page_that_does_not_open_is_reported_in_one_line(player: Player, task: str, message: str) -> None:
    with pytest.raises(RuntimeError, match=message) as error:
        player.open(task)
    assert "\n" not in str(error.value)
    row_of(player.open("other"), "Other page")


def test_a_page_that_loops_costs_its_episode_only(player: Player) -> None:
    seen = player.farm.reset({0: player.spec("loop"), 1: player.spec("form")})
    results = player.farm.step(
        {
            0: Command(verb=Verb.CLICK, ref=ref_of(seen[0], "Loop"), following=player.spec("other")),
            1: Command(verb=Verb.TYPE, ref=ref_of(seen[1], "Customer", "input_text"), text="Ada"),
        }
    )
    assert (results[0].lost, results[1].lost) == ("page_hung", "")
    row_of(after(results[0]), "Other page")
    assert "Ada" in after(results[1]).page.value
    assert player.causes == ["page_hung"]


def test_a_crashed_page_costs_its_episode_only(player: Player) -> None:
    player.farm.reset({0: player.spec("crash"), 1: player.spec("form")})
    player.farm._tools.post(player.farm._episodes[0].session.id, "Page.crash")
    following = player.spec("other")
    results = player.farm.step({tab: Command(verb=Verb.WAIT, following=following) for tab in (0, 1)})
    assert (results[0].lost, results[1].lost) == ("tab_crashed", "")
    row_of(after(results[0]), "Other page")


def test_after_chrome_was_killed_another_one_plays_on(player: Player) -> None:
    player.farm.reset({0: player.spec("other"), 1: player.spec("form")})
    for pid in reaper.processes(Path(player.farm.chrome_directory)):
        os.kill(pid, signal.SIGKILL)
    following = player.spec("other")
    results = player.farm.step({tab: Command(verb=Verb.WAIT, following=following) for tab in (0, 1)})
    assert {result.lost for result in results.values()} == {"browser_died"}
    for result in results.values():
        row_of(after(result), "Other page")
    assert "browser_died" in player.causes


def test_a_condition_whose_script_throws_does_not_hold_and_is_counted(player: Player) -> None:
    seen = player.open("throws")
    result = player.act(Verb.CLICK, ref_of(seen, "green"), last=True)
    assert (result.raw_reward, result.done, result.lost) == (0.0, False, "")
    assert player.counts["script_errors"] == 1
