"""The report of a run on real pages, loaded in Chrome: wide and narrow, light and dark, and printed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from giirl.cli.main import giirl
from giirl.report.render import render, scale_view, strip_view
from giirl_core.files import write_json
from tests.giirl.report.examples import HOSTILE, SCALE, hostile_strip
from tests.giirl.report.reader import Reader, Reading
from tests.giirl.small import run

pytestmark = [pytest.mark.chrome, pytest.mark.slow, pytest.mark.timeout(300)]  # five Chromes in sequence

WIDTHS = (390, 1400)


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a small run on real pages."""
    path = tmp_path_factory.mktemp("real") / "run"
    write_json(path / "result.json", run(path, "browser=chrome", "iterations=2", "step_limit=2"))
    done = CliRunner().invoke(giirl, ["report", str(path), "--pages", "2"])
    assert done.exit_code == 0, done.exception
    return path / "report.html"


@pytest.fixture(scope="module")
def reader() -> Iterator[Reader]:
    with Reader() as reader:
        yield reader


def assert_sound(found: Reading, width: int) -> None:
    assert found.console == ()
    assert found.requests == ()
    assert (found.broken, found.without_alt, found.scripts) == (0, 0, 0)
    assert found.scroll_width <= width
    assert found.smallest_px >= 12
    steps = [after - before for before, after in zip(found.headings, found.headings[1:], strict=False)]
    assert found.headings[0] == 1
    assert max(steps) <= 1  # no heading level is skipped


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("dark", [False, True])
def test_the_report_of_a_real_run_loads_without_errors(real: Path, reader: Reader, width: int, dark: bool) -> None:
    found = reader.read(real, width=width, dark=dark)
    assert_sound(found, width)
    assert found.images >= 2 * (1 + 2 + 1 + 2)  # pages x instructions per task, with at least one step each
    assert (found.background == "rgb(255, 255, 255)") is not dark


def test_the_report_prints_on_white_without_its_collapsed_parts(real: Path, reader: Reader) -> None:
    found = reader.read(real, width=718, dark=True, media="print")
    assert_sound(found, 718)
    assert found.background == "rgb(255, 255, 255)"
    assert "All settings" not in found.text


@pytest.mark.parametrize("width", WIDTHS)
def test_hostile_page_text_is_shown_as_text(reader: Reader, tmp_path: Path, width: int) -> None:
    words = {"title": HOSTILE, "lead": HOSTILE, "origin": HOSTILE, "command": HOSTILE}
    page = tmp_path / "hostile.html"
    page.write_text(render("inspect.html", strip=strip_view(hostile_strip(), SCALE), scale=scale_view(SCALE), **words))
    found = reader.read(page, width=width)
    assert_sound(found, width)
    assert HOSTILE in found.text


def test_the_reader_detects_the_faults_of_a_page(reader: Reader, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text(
        "<h1>t</h1><p style='width: 900px'>wide</p><img src='data:image/png;base64,AAAA'>"
        "<img src='http://example.invalid/a.png'><script>throw new Error('no')</script>"
    )
    found = reader.read(page, width=390)
    assert (found.broken, found.without_alt, found.scripts) == (2, 2, 1)
    assert found.scroll_width > 390
    assert found.requests == ("http://example.invalid/a.png",)
    assert any("Error: no" in message for message in found.console)
