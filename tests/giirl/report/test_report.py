"""The report of small runs: what there is of a run is on the page, and what is not there is said."""

from __future__ import annotations

import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from giirl.cli.main import giirl
from giirl.report.render import render, scale_view, strip_view
from giirl.run.folder import RunFolder
from giirl_core.files import write_json
from giirl_core.types import Purpose, page_seed
from tests.giirl.report.examples import HOSTILE, SCALE, hostile_strip
from tests.giirl.small import run

ROOT = Path(__file__).parents[3]
VOID = {"meta", "link", "img", "br", "rect", "path", "line", "polyline", "stop"}
FETCHES = ("src", "href", "xlink:href", "srcset", "data", "action", "poster")


class Reading(HTMLParser):
    """A page as a browser parses it: its tags, its texts, and whatever it would fetch."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.fetches: list[str] = []
        self.handlers: list[str] = []
        self.nameless = 0
        self.texts: list[str] = []
        self.feed(page)
        self.text = " ".join(" ".join(self.texts).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.fetches += [value or "" for name, value in attrs if name in FETCHES]
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.nameless += tag == "img" and not dict(attrs).get("alt")

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that came to its end, in the fake browser."""
    path = tmp_path_factory.mktemp("finished") / "run"
    write_json(path / "result.json", run(path))
    return path


def command(*words: str | Path) -> Result:
    return CliRunner().invoke(giirl, [str(word) for word in words])


def reported(path: Path, *words: str | Path) -> Reading:
    done = command("report", path, "--pages", "2", *words)
    assert done.exit_code == 0, done.exception
    return Reading((path / "report.html").read_text())


def test_a_finished_run_is_reported_whole(finished: Path) -> None:
    page = reported(finished)
    for words in ("Result", "Success rate during training", "Discriminator accuracy by source, %", "Episodes"):
        assert words in page.text
    for setting in ("browser=fake", "net.width=16", "demos.per_task=4"):
        assert setting in page.texts
    assert page.text.count("Under its own instruction") >= 8
    for task in ("click-test", "click-test-2", "click-button", "enter-text"):
        for index in range(2):
            assert f"Page {page_seed(Purpose.INSPECT, 0, index)}" in page.text
        assert task in page.texts
    assert "has no screenshots" in page.text
    assert "Click button TWO." in page.texts


def test_a_page_fetches_nothing_and_runs_nothing(finished: Path) -> None:
    page = reported(finished)
    assert [address for address in page.fetches if not address.startswith("data:")] == []
    assert "script" not in page.tags
    assert page.handlers == []
    assert page.nameless == 0
    assert not re.search(r"url\((?!#)", (finished / "report.html").read_text())


def test_the_same_run_gives_the_same_page(finished: Path, tmp_path: Path) -> None:
    for name in ("one.html", "two.html"):
        assert command("report", finished, "--pages", "1", "--out", tmp_path / name).exit_code == 0
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_text_of_a_page_that_looks_like_html_stays_text() -> None:
    strip = strip_view(hostile_strip(), SCALE)
    words = {"title": HOSTILE, "lead": HOSTILE, "origin": HOSTILE, "command": HOSTILE}
    page = Reading(render("inspect.html", strip=strip, scale=scale_view(SCALE), **words))
    assert "script" not in page.tags
    assert "img" not in page.tags
    assert page.handlers == []
    assert "".join(HOSTILE.split()) in "".join(page.text.split())


def test_a_run_under_way_is_reported_as_far_as_it_came(finished: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(finished, tmp_path / "run"))
    (path / "result.json").unlink()
    RunFolder(path).cut_curve(2)
    page = reported(path)
    assert "unfinished, after 2 of 4 iterations" in page.text
    assert "has no evaluation result" in page.text
    assert page.text.count("Under its own instruction") >= 8
    shutil.rmtree(path / "checkpoints")
    assert "holds no checkpoint" in reported(path).text
    (path / "curve.jsonl").unlink()
    (path / "demonstrations.giirl").unlink()
    assert "after 0 of 4 iterations" in reported(path).text


def test_a_cloning_run_has_no_reward_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "run"
    run(path, "algorithm=cloning")
    page = reported(path)
    assert "No reward is shown: cloning learns only a policy." in page.text
    assert "ramp" not in (path / "report.html").read_text().partition("<body>")[2]
    assert "The policy takes" in page.text


def test_a_gridcraft_run_shows_its_returns_and_its_maps(tmp_path: Path) -> None:
    path = tmp_path / "run"
    quick = ["iterations=5", "rollout_batch=2", "discriminator.updates=1", "policy.updates=2", "grid.random_episodes=5"]
    done = command("train", ROOT / "experiments/gridcraft.toml", f"run={path}", *quick)
    assert done.exit_code == 0, done.exception
    page = reported(path)
    for words in ("Go to Red. Avoid Blue.", "EPIC distance", "The learned reward as a map", "Return during training"):
        assert words in page.text
    maps = re.findall(r'aria-label="(Go to [^"]*Mean reward by region[^"]*)"', (path / "report.html").read_text())
    assert len(maps) == 6
    assert maps[0].startswith("Go to Red. Avoid Green. Mean reward by region: red ")
    asked = command("reward", "inspect", path, "--task", "click-test", "--seed", "1")
    assert "which has no pages" in str(asked.exception)


def test_inspect_draws_a_page_under_the_instruction_that_was_asked_for(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    words = ("reward", "inspect", finished, "--task", "click-button", "--seed", "5", "--out", out)
    assert command(*words, "--goal", 'Click on the "<b>" button.').exit_code == 0
    page = Reading(out.read_text())
    assert 'Click on the "<b>" button.' in page.texts
    assert page.text.count("Under its own instruction") == 1
    assert page.text.count("The numbers of all") == 1
    assert command(*words).exit_code == 0
    assert '"<b>"' not in Reading(out.read_text()).text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["report", "nowhere"], "nowhere is no run"),
        (["report", "RUN", "--out", "missing/a.html"], "cannot write missing/a.html"),
        (["reward", "inspect", "RUN", "--task", "click-buton", "--seed", "1"], "no task 'click-buton'"),
        (["reward", "inspect", "RUN", "--task", "click-test", "--seed", f"{1 << 53}"], "is out of range"),
        (["reward", "inspect", "RUN", "--task", "click-test", "--seed", "1", "--goal", " "], "at least one word"),
    ],
)
def test_what_cannot_be_drawn_is_said_and_leaves_no_page(
    words: list[str], said: str, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = [] if "--out" in words else ["--out", "page.html"]
    done = command(*(str(finished) if word == "RUN" else word for word in words), *out)
    assert isinstance(done.exception, ValueError)
    assert said in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_result_is_named(finished: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(finished, tmp_path / "run"))
    (path / "result.json").write_text("{")
    out = tmp_path / "page.html"
    done = command("report", path, "--out", out)
    assert isinstance(done.exception, ValueError)
    assert "result.json is damaged" in str(done.exception)
    assert not out.exists()
