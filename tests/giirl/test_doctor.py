"""`giirl doctor`: what it finds on this machine, and what it says about what is missing."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import pytest

from giirl import doctor
from giirl.doctor import Dependency
from tests.browser_farm import machines

REQUIRES = [
    "click<9,>=8.3",
    "ray[default]<3,>=2.60; extra == 'cluster'",
    'no-such-distribution>=1; extra == "cluster"',
    "giirl[cluster]; extra == 'all'",  # a build backend may also write it out, as in the next line
    "ray[default]<3,>=2.60; extra == 'all'",
    "pytest>=9; extra == 'dev'",
]


def test_a_missing_browser_is_reported_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("GIIRL_CHROME", raising=False)
    chrome = doctor.program("Chromium", "GIIRL_CHROME", "chromium", package="chromium")
    assert not chrome.ok
    assert "apt-get install chromium" in chrome.fix
    assert not doctor.same_major(chrome, chrome).ok


def test_a_driver_of_another_major_version_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for variable, version in (("GIIRL_CHROME", "156.0.1"), ("GIIRL_CHROMEDRIVER", "150.0.7")):
        program = tmp_path / variable
        program.write_text(f"#!/bin/sh\necho Program {version} built on some day\n")
        program.chmod(0o755)
        monkeypatch.setenv(variable, str(program))
    chrome = doctor.program("Chromium", "GIIRL_CHROME", "chromium", package="chromium")
    driver = doctor.program("chromedriver", "GIIRL_CHROMEDRIVER", "chromedriver", package="chromium-driver")
    assert chrome.ok
    assert driver.ok
    agreement = doctor.same_major(chrome, driver)
    assert not agreement.ok
    assert agreement.found == "156 and 150"


def test_the_packages_to_check_are_those_of_the_metadata_each_once_and_without_the_development_tools(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: REQUIRES if name == "giirl" else None)
    assert doctor.dependencies() == [
        Dependency("click"),
        Dependency("ray", "cluster"),
        Dependency("no-such-distribution", "cluster"),
    ]


def test_every_package_that_is_installed_is_found_under_its_import_name() -> None:
    assert {doctor.import_name(name) for name in ("pillow", "pyzmq", "torch", "xxhash", "websocket-client")} == {
        "PIL",
        "zmq",
        "torch",
        "xxhash",
        "websocket",
    }
    assert doctor.package(Dependency("click")).ok


def test_a_missing_package_is_an_error_unless_it_belongs_to_an_extra_which_is_then_named() -> None:
    missing = doctor.package(Dependency("no-such-distribution"))
    assert not missing.ok
    assert missing.needed
    optional = doctor.package(Dependency("no-such-distribution", "cluster"))
    assert not optional.ok
    assert not optional.needed
    assert "extra 'cluster'" in optional.found
    assert optional.fix == "pip install 'giirl[cluster]'"


def test_a_package_that_cannot_be_imported_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "import_name", lambda distribution: "no_such_module")
    check = doctor.package(Dependency("click", "some-extra"))
    assert not check.ok
    assert check.needed
    assert "no_such_module" in check.found


def test_recordings_are_counted_and_an_empty_folder_differs_from_a_missing_one(tmp_path: Path) -> None:
    assert "no folder" in doctor.recordings(tmp_path / "nowhere").found
    assert not doctor.recordings(tmp_path).ok
    (tmp_path / "COLLECTION/click-test").mkdir(parents=True)
    (tmp_path / "COLLECTION/click-test/one.json.gz").write_bytes(b"")
    assert doctor.recordings(tmp_path).found.startswith("1 recordings")


def test_loopback_counts_only_if_it_can_be_connected_to() -> None:
    assert doctor.loopback().ok
    look = "from giirl import doctor; check = doctor.loopback(); print(check.ok, check.found, check.fix)"
    said = machines.run(machines.NO_LOOPBACK, "-c", look).stdout
    assert said.startswith("False [Errno 101] Network is unreachable")
    assert "ip link set lo up" in said


@pytest.mark.chrome
def test_chrome_is_started_and_shows_a_page() -> None:
    check = doctor.browser()
    assert check.ok
    assert "Click the button." in check.found


@pytest.mark.chrome
def test_a_chrome_that_is_installed_but_does_not_start_is_missing() -> None:
    done = machines.run(machines.NO_NAMESPACES, "-m", "giirl", "doctor", COLUMNS="2000")
    assert done.returncode == 1
    (line,) = (line for line in done.stdout.splitlines() if "No usable sandbox!" in line)
    assert "MISSING" in line
    assert "GIIRL_CHROME_SANDBOX=off" in line
    assert done.stderr == "giirl: missing: Chromium shows a page; the table says how to get them\n"


@pytest.mark.parametrize(("limit", "ok", "found"), [(1024, True, "1024, enough for 128 actors"), (256, False, "256, ")])
def test_the_limit_on_open_files_is_shown_as_a_number_of_actors(
    limit: int, ok: bool, found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "open_files_limit", lambda: limit)
    check = doctor.open_files()
    assert check.ok is ok
    assert check.found.startswith(found)
    assert check.name in {one.name for one in doctor.checks()}
