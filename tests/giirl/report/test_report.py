"""Reports of small runs contain the data of the run and name missing parts."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from giirl.cli.main import giirl
from giirl.report.element_rewards import EpisodeView, Frame
from giirl.report.overlay import format_reward
from giirl.report.render import render, scale_view, strip_view
from giirl.run.folder import RunFolder
from giirl_core.files import write_json
from giirl_core.types import Outcome, Purpose, page_seed
from tests.giirl.report.examples import HOSTILE, SCALE, TWO, hostile_strip, scored
from tests.giirl.small import run

ROOT = Path(__file__).parents[3]
VOID = {"meta", "link", "img", "br", "rect", "path", "line", "polyline", "stop"}
FETCHES = ("src", "href", "xlink:href", "srcset", "data", "action", "poster")


class Reading(HTMLParser):
    """A parsed page: its tags, texts, event handlers and the URLs that it would fetch."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.fetches: list[str] = []
        self.handlers: list[str] = []
        self.without_alt = 0
        self.texts: list[str] = []
        self.feed(page)
        self.text = " ".join(" ".join(self.texts).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.fetches += [value or "" for name, value in attrs if name in FETCHES]
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.without_alt += tag == "img" and not dict(attrs).get("alt")

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run in the fake browser."""
    path = tmp_path_factory.mktemp("finished") / "run"
    write_json(path / "result.json", run(path))
    return path


def command(*words: str | Path) -> Result:
    return CliRunner().invoke(giirl, [str(word) for word in words])


def reported(path: Path, *words: str | Path) -> Reading:
    done = command("report", path, "--pages", "2", *words)
    assert done.exit_code == 0, done.exception
    return Reading((path / "report.html").read_text())


def test_the_report_of_a_finished_run_has_all_sections(finished: Path) -> None:
    page = reported(finished)
    for words in ("Result", "Success rate during training", "Discriminator accuracy by source, %", "Episodes"):
        assert words in page.text
    for words in ("Throughput", "Share of time waiting, %"):
        assert words in page.text
    for setting in ("browser=fake", "net.width=16", "demos.per_task=4"):
        assert setting in page.texts
    assert page.text.count("Own instruction") >= 8
    for task in ("click-test", "click-test-2", "click-button", "enter-text"):
        for index in range(2):
            assert f"Page {page_seed(Purpose.INSPECT, 0, index)}" in page.text
        assert any(re.fullmatch(rf"{task}, [0-9.]+ %", text) for text in page.texts)
    assert "has no screenshots" in page.text
    assert "Click button TWO." in page.texts


def test_a_report_fetches_no_urls_and_runs_no_scripts(finished: Path) -> None:
    page = reported(finished)
    assert [url for url in page.fetches if not url.startswith("data:")] == []
    assert "script" not in page.tags
    assert page.handlers == []
    assert page.without_alt == 0
    assert not re.search(r"url\((?!#)", (finished / "report.html").read_text())


def test_the_report_of_a_run_is_deterministic(finished: Path, tmp_path: Path) -> None:
    for name in ("one.html", "two.html"):
        assert command("report", finished, "--pages", "1", "--out", tmp_path / name).exit_code == 0
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_a_report_begins_with_the_tasks_of_the_lowest_success(finished: Path) -> None:
    tasks = ("click-test", "click-test-2", "click-button", "enter-text")
    found = [re.fullmatch(rf"({'|'.join(tasks)}), ([0-9.]+) %", text) for text in reported(finished).texts]
    success = [float(one[2]) for one in found if one]
    assert len(success) == len(tasks)
    assert success == sorted(success)


FAILED = Outcome(raw_reward=-1.0, ended=True)
CANCEL = f"click button “Cancel” ({format_reward(-3.2)})"


@pytest.mark.parametrize(
    ("reward", "outcome", "cause"),
    [
        (-3.2, FAILED, f"The reward rejects step 1, {CANCEL}, and prefers click button “Ok” (+4.8)."),
        (5.0, FAILED, "The reward accepts every step: it does not know what is wrong either."),
        (None, FAILED, ""),
        (-3.2, replace(FAILED, raw_reward=1.0), ""),
        (-3.2, None, ""),
    ],
)
def test_a_failed_episode_says_whether_the_reward_knew_better(
    reward: float | None, outcome: Outcome | None, cause: str
) -> None:
    frame = Frame(page=TWO, screenshot=None, own=replace(scored(4.8, -3.2, chosen=1), policy_reward=reward), other=None)
    episode = EpisodeView(task="click-button", seed=1, frames=(frame,), outcome=outcome)
    assert strip_view(episode, SCALE).cause == cause


def test_a_reward_may_know_nothing_better_than_a_step_that_it_rejects() -> None:
    own = replace(scored(-4.0, -3.2, chosen=1), policy_reward=-3.2)
    episode = EpisodeView(
        task="click-button", seed=1, frames=(Frame(page=TWO, screenshot=None, own=own, other=None),), outcome=FAILED
    )
    assert strip_view(episode, SCALE).cause.endswith("and knows nothing better.")


def test_html_in_page_text_is_escaped() -> None:
    strip = strip_view(hostile_strip(), SCALE)
    words = {"title": HOSTILE, "lead": HOSTILE, "origin": HOSTILE, "command": HOSTILE}
    page = Reading(render("inspect.html", strip=strip, scale=scale_view(SCALE), **words))
    assert "script" not in page.tags
    assert "img" not in page.tags
    assert page.handlers == []
    assert "".join(HOSTILE.split()) in "".join(page.text.split())


def test_an_unfinished_run_is_reported_up_to_its_last_iteration(finished: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(finished, tmp_path / "run"))
    (path / "result.json").unlink()
    RunFolder(path).cut_curve(2)
    page = reported(path)
    assert "unfinished, after 2 of 4 iterations" in page.text
    assert "has no evaluation result" in page.text
    assert page.text.count("Own instruction") >= 8
    shutil.rmtree(path / "checkpoints")
    assert "has no checkpoint yet" in reported(path).text
    (path / "curve.jsonl").unlink()
    (path / "demonstrations.giirl").unlink()
    assert "after 0 of 4 iterations" in reported(path).text


def test_the_report_of_a_cloning_run_states_that_there_is_no_reward(tmp_path: Path) -> None:
    path = tmp_path / "run"
    run(path, "algorithm=cloning")
    page = reported(path)
    assert "No reward is shown: cloning learns only a policy." in page.text
    assert "ramp" not in (path / "report.html").read_text().partition("<body>")[2]
    assert "Policy action: click" in page.text


def test_the_report_of_a_gridcraft_run_shows_returns_and_heat_maps(tmp_path: Path) -> None:
    path = tmp_path / "run"
    quick = ["iterations=5", "rollout_batch=2", "discriminator.updates=1", "policy.updates=2", "grid.random_episodes=5"]
    done = command("train", ROOT / "experiments/gridcraft.toml", f"run={path}", *quick)
    assert done.exit_code == 0, done.exception
    page = reported(path)
    for words in (
        "Go to Red. Avoid Blue.",
        "EPIC distance",
        "Heat maps of the learned reward",
        "Return during training",
    ):
        assert words in page.text
    maps = re.findall(r'aria-label="(Go to [^"]*Mean reward by region[^"]*)"', (path / "report.html").read_text())
    assert len(maps) == 6
    assert maps[0].startswith("Go to Red. Avoid Green. Mean reward by region: red ")
    done = command("reward", "inspect", path, "--task", "click-test", "--seed", "1")
    assert "which has no pages" in str(done.exception)


def test_inspect_draws_a_page_under_the_requested_instruction(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    words = ("reward", "inspect", finished, "--task", "click-button", "--seed", "5", "--out", out)
    assert command(*words, "--goal", 'Click on the "<b>" button.').exit_code == 0
    page = Reading(out.read_text())
    assert 'Click on the "<b>" button.' in page.texts
    assert page.text.count("Own instruction") == 1
    assert page.text.count("Rewards of all elements") == 1
    assert command(*words).exit_code == 0
    assert '"<b>"' not in Reading(out.read_text()).text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["report", "nowhere"], "nowhere is not a run"),
        (["report", "RUN", "--out", "missing/a.html"], "cannot write missing/a.html"),
        (["reward", "inspect", "RUN", "--task", "click-buton", "--seed", "1"], "no task 'click-buton'"),
        (["reward", "inspect", "RUN", "--task", "click-test", "--seed", f"{1 << 53}"], "is out of range"),
        (["reward", "inspect", "RUN", "--task", "click-test", "--seed", "1", "--goal", " "], "at least one word"),
    ],
)
def test_an_illegal_request_is_an_error_and_writes_no_file(
    words: list[str], message: str, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = [] if "--out" in words else ["--out", "page.html"]
    done = command(*(str(finished) if word == "RUN" else word for word in words), *out)
    assert isinstance(done.exception, ValueError)
    assert message in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_result_file_is_an_error_with_its_name(finished: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(finished, tmp_path / "run"))
    (path / "result.json").write_text("{")
    out = tmp_path / "page.html"
    done = command("report", path, "--out", out)
    assert isinstance(done.exception, ValueError)
    assert "result.json is damaged" in str(done.exception)
    assert not out.exists()
