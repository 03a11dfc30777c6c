"""The report of a real run, read in a real browser, wide and narrow, in the light and in the dark."""

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

pytestmark = [pytest.mark.chrome, pytest.mark.slow, pytest.mark.timeout(300)]  # five Chromes, one after the other

WIDTHS = (390, 1400)


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run on real pages, and its report."""
    path = tmp_path_factory.mktemp("real") / "run"
    write_json(path / "result.json", run(path, "browser=chrome", "iterations=2", "step_limit=2"))
    done = CliRunner().invoke(giirl, ["report", str(path), "--pages", "2"])
    assert done.exit_code == 0, done.exception
    return path / "report.html"


@pytest.fixture(scope="module")
def reader() -> Iterator[Reader]:
    with Reader() as one:
        yield one


def nothing_is_wrong(seen: Reading, width: int) -> None:
    assert seen.complaints == ()
    assert seen.addresses == ()
    assert (seen.broken, seen.nameless, seen.scripts) == (0, 0, 0)
    assert seen.scroll_width <= width
    assert seen.smallest_px >= 12
    steps = [after - before for before, after in zip(seen.headings, seen.headings[1:], strict=False)]
    assert seen.headings[0] == 1
    assert max(steps) <= 1  # no level is left out on the way down


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("dark", [False, True])
def test_the_report_of_a_real_run_opens_whole(real: Path, reader: Reader, width: int, dark: bool) -> None:
    seen = reader.read(real, width=width, dark=dark)
    nothing_is_wrong(seen, width)
    assert seen.images >= 2 * (1 + 2 + 1 + 2)  # pages x instructions that fit, each at least one step long
    assert (seen.paper == "rgb(255, 255, 255)") is not dark


def test_the_report_prints_on_white_without_its_folded_parts(real: Path, reader: Reader) -> None:
    seen = reader.read(real, width=718, dark=True, media="print")
    nothing_is_wrong(seen, 718)
    assert seen.paper == "rgb(255, 255, 255)"
    assert "Every setting" not in seen.text


@pytest.mark.parametrize("width", WIDTHS)
def test_a_page_that_means_harm_is_shown_as_text(reader: Reader, tmp_path: Path, width: int) -> None:
    words = {"title": HOSTILE, "lead": HOSTILE, "origin": HOSTILE, "command": HOSTILE}
    page = tmp_path / "hostile.html"
    page.write_text(render("inspect.html", strip=strip_view(hostile_strip(), SCALE), scale=scale_view(SCALE), **words))
    seen = reader.read(page, width=width)
    nothing_is_wrong(seen, width)
    assert HOSTILE in seen.text


def test_the_reader_sees_what_is_wrong_with_a_page(reader: Reader, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text(
        "<h1>t</h1><p style='width: 900px'>wide</p><img src='data:image/png;base64,AAAA'>"
        "<img src='http://example.invalid/a.png'><script>throw new Error('no')</script>"
    )
    seen = reader.read(page, width=390)
    assert (seen.broken, seen.nameless, seen.scripts) == (2, 2, 1)
    assert seen.scroll_width > 390
    assert seen.addresses == ("http://example.invalid/a.png",)
    assert any("Error: no" in complaint for complaint in seen.complaints)
