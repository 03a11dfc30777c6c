"""No episode sees anything of another, and pages reach the allowed origins only."""

from __future__ import annotations

import time

import pytest

from giirl_core.types import Verb
from tests.browser_farm.sites.player import Player, after, ref_of, row_of

pytestmark = pytest.mark.chrome
STORED = "seen: k=cookie|local|session|named|indexed|cached|1"


def stored(player: Player, *, tab: int = 0) -> str:
    """What the page of a new episode finds in its stores, which it then fills."""
    return next(text for text in player.open("store", tab=tab).page.text if text.startswith("seen:"))


def test_cookies_storage_databases_caches_and_service_workers_end_with_their_episode(player: Player) -> None:
    seen = player.open("store")
    row_of(seen, "seen:")
    row_of(after(player.click(seen, "Again")), STORED)  # within the episode all of it is kept
    assert stored(player) == "seen:"  # the next episode of the tab
    assert stored(player, tab=1) == "seen:"  # another tab, while the first one is open


def test_a_login_is_not_seen_by_the_next_episode_nor_by_another_tab(player: Player) -> None:
    seen = player.open("private")
    row_of(seen, "Welcome Ada")
    seen = player.open("login")
    seen = after(player.act(Verb.TYPE, ref_of(seen, "User", "input_text"), "Grace"))
    row_of(after(player.click(seen, "Log in")), "Welcome Grace")
    for tab in (1, 0):
        with pytest.raises(RuntimeError, match=r"login_expired the login has expired: the first page is .*/login"):
            player.open("expired", tab=tab)


def test_a_stored_login_fills_the_local_storage_before_the_page_runs(player: Player) -> None:
    row_of(player.open("stored"), "token T1")
    row_of(player.open("local"), "token null")


def test_a_page_that_calls_a_foreign_origin_gets_nowhere_and_is_counted(player: Player) -> None:
    seen = player.open("foreign")
    row_of(seen, "refused")
    refused = player.farm.refused
    assert refused["foreign.test"] >= 4  # frame, image, beacon, fetch
    assert refused["127.0.0.1:4319"] >= 1  # loopback is no exception
    assert player.counts["requests_refused"] >= 5


def test_a_link_to_a_foreign_origin_leaves_the_page_as_it_is(player: Player) -> None:
    seen = player.open("foreign")
    result = player.click(seen, "Leave")
    assert result.reason == "the origin of http://foreign.test/ is not among the allowed"
    row_of(after(result), "Leave")


def test_a_service_worker_reaches_no_foreign_origin_either(player: Player) -> None:
    seen, deadline = player.open("worker-page"), time.monotonic() + 20
    while "refused" not in seen.page.text and time.monotonic() < deadline:  # a worker may still be busy on a quiet page
        seen = after(player.act(Verb.WAIT, 0))
    row_of(seen, "refused")


def test_ended_episodes_leave_no_page_and_no_context_behind(player: Player) -> None:
    for seed in range(5):
        player.open("other", seed=seed)
        player.act(Verb.WAIT, 0, last=True)
    player.open("form")
    deadline = time.monotonic() + 20
    while len(pages_of(player)) > 2 and time.monotonic() < deadline:  # Chrome's first page, and that of the episode
        time.sleep(0.05)
    assert len(pages_of(player)) <= 2
    found = player.farm._tools.call("", "Target.getBrowserContexts", timeout_s=5)["browserContextIds"]
    assert player.farm._episodes[0].session.context in found
    assert len(found) == len(player.farm._episodes)


def pages_of(player: Player) -> list[str]:
    """The addresses of the pages that Chrome has, without those of the other tab's episode."""
    other = {episode.session.target for tab, episode in player.farm._episodes.items() if tab}
    targets = player.farm._tools.call("", "Target.getTargets", timeout_s=5)["targetInfos"]
    return [one["url"] for one in targets if one["type"] == "page" and one["targetId"] not in other]
