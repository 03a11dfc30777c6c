"""Pages played by several processes: the same episodes as in one process, and shares of dead ones are repeated."""

from __future__ import annotations

import threading
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from actors.player import AgentSpec, BrowserPlayer, open_browser_player
from actors.player_process import PlayerProcess
from actors.pool import MAX_TRIES, PagePool, shares
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import serialise_net
from giirl_core.nets.reward import build_policy
from giirl_core.types import Episode, Purpose
from tests.giirl.small import config
from tests.thread_platform import ThreadPlatform

PAGES = 12


def keys(episodes: list[Episode]) -> list[tuple[str, int, bytes, bool]]:
    """What an episode is known by, sorted: task, seed, actions, success."""
    found = []
    for episode in episodes:
        actions = repr(episode.trajectory.actions).encode()
        found.append((episode.trajectory.task, episode.trajectory.seed, actions, episode.outcome.success))
    return sorted(found)


@pytest.fixture
def pool(tmp_path: Path) -> PagePool:
    return PagePool(config(tmp_path, "actors.count=3"), "run", ThreadPlatform(), Metrics())


@pytest.mark.parametrize("kind", ["expert", "random", "greedy"])
def test_a_pool_plays_the_same_episodes_as_one_browser(kind: str, pool: PagePool, tmp_path: Path) -> None:
    settings = config(tmp_path)
    policy = serialise_net(build_policy(settings), 3) if kind == "greedy" else None
    spec = AgentSpec(kind=kind, policy=policy)  # type: ignore[arg-type]
    with closing(pool), open_browser_player(settings, Metrics()) as player:
        alone = player.play(spec, Purpose.EVALUATE, PAGES, first=5)
        together = pool.play(spec, Purpose.EVALUATE, PAGES, first=5)
    assert keys(together) == keys(alone)
    assert len(together) == 4 * PAGES


def test_the_share_of_a_process_that_died_is_played_again(pool: PagePool, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: Counter[int] = Counter()
    play = BrowserPlayer.play

    def failing(self: BrowserPlayer, spec: AgentSpec, purpose: Purpose, pages: int, **how: Any) -> list[Episode]:
        first = how["first"]
        calls[first] += 1
        if first == 4 and calls[first] < MAX_TRIES:
            raise RuntimeError("the browser is gone")
        return play(self, spec, purpose, pages, **how)

    monkeypatch.setattr(BrowserPlayer, "play", failing)
    with closing(pool):
        episodes = pool.play(AgentSpec(kind="random"), Purpose.RANDOM, PAGES)
        assert len({(e.trajectory.task, e.trajectory.seed) for e in episodes}) == len(episodes) == 4 * PAGES
        assert calls[4] == MAX_TRIES
        calls[4] = -100
        with pytest.raises(RuntimeError, match=r"pages 4 to 4 could not be played, tried 3 times: .*browser is gone"):
            pool.play(AgentSpec(kind="random"), Purpose.RANDOM, PAGES)


def test_a_share_goes_to_another_process_when_its_own_ends(pool: PagePool, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[PlayerProcess] = []
    play = PlayerProcess.play

    def dying(self: PlayerProcess, *values: object) -> list[bytes]:
        if not ended:
            ended.append(self)
            self.stop()  # `run` returns, and this call never does
            self._left.wait()  # type: ignore[attr-defined]
        return play(self, *values)  # type: ignore[arg-type]

    monkeypatch.setattr(PlayerProcess, "_left", threading.Event(), raising=False)
    monkeypatch.setattr(PlayerProcess, "play", dying)
    with closing(pool):
        episodes = pool.play(AgentSpec(kind="random"), Purpose.RANDOM, PAGES)
        PlayerProcess._left.set()  # type: ignore[attr-defined]
    assert len({(e.trajectory.task, e.trajectory.seed) for e in episodes}) == len(episodes) == 4 * PAGES


@pytest.mark.parametrize(("first", "pages", "processes"), [(0, 1, 8), (7, 100, 3), (0, 10, 100), (2, 9, 1)])
def test_shares_cover_every_page_once(first: int, pages: int, processes: int) -> None:
    parts = shares(first, pages, processes)
    covered = [page for share in parts for page in range(share.first, share.first + share.pages)]
    assert covered == list(range(first, first + pages))
