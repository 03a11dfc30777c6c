"""Fixtures: one web server and one farm for all tests of own pages, because starting Chrome takes seconds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.browser_farm.sites.player import Player
from tests.browser_farm.sites.web_site import WebSite


@pytest.fixture(scope="package")
def site() -> Iterator[WebSite]:
    server = WebSite()
    yield server
    server.close()


@pytest.fixture(scope="package")
def started(site: WebSite, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Player]:
    folder: Path = tmp_path_factory.mktemp("tasks")
    player = Player(site, folder)
    yield player
    player.close()


@pytest.fixture
def player(started: Player) -> Player:
    started.causes.clear()
    started.counts.clear()
    return started
