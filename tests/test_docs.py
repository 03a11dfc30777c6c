"""Documents match the code: links, commands, settings and names in them exist, and no old name is left."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import click
import pytest
from prometheus_client import Counter, Gauge, Histogram
from pydantic import TypeAdapter

from giirl.cli.main import giirl
from giirl.run.grid import learn
from giirl_core.config import Config
from giirl_core.config_file import keys, load_config
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import SCHEMA
from tests.giirl.small import run
from tests.old_names import OLD_NAMES

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in ("*.md", "docs/*.md", "deploy/*.md", "experiments/*.md", "benchmarks/results/*.md")
    for path in ROOT.glob(pattern)
)
MAX_COLUMNS = 120
MAX_README_LINES = 150
FOLDERS = (
    "actors|benchmarks|browser_farm|deploy|docs|experiments|giirl|giirl_core|gridcraft|learner|reward_service|tests"
)
SETTING = re.compile(r"([a-z_]+(?:\.[a-z_]+)*)=\S*")
PYTHON_API = ("docs/farm.md", "docs/gymnasium.md", "docs/reward.md")  # key=value in these are arguments of functions
OLD_SETTINGS = "CHANGELOG.md"  # lists old and new names
OLD_NAMES_LISTED = (OLD_SETTINGS, "giirl_core/renamed_settings.py", "tests/old_names.py", "tests/test_docs.py")


def read(document: str) -> str:
    return (ROOT / document).read_text()


def prose(document: str) -> str:
    """A document without its fenced and indented blocks of code."""
    text = re.sub(r"^```.*?^```$", "", read(document), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"^ {4}.*$", "", text, flags=re.MULTILINE)


def spans(document: str) -> list[str]:
    """Code within the text: what is in backticks, on one line."""
    paragraphs = re.split(r"\n\s*\n", prose(document))
    return [" ".join(span.split()) for part in paragraphs for span in re.findall(r"`([^`]+)`", part)]


def shell_lines(document: str) -> list[str]:
    """Lines of indented blocks, with continued lines joined and explanations cut off."""
    blocks = "\n".join(re.findall(r"^ {4}(.*)$", read(document), re.MULTILINE))
    lines = re.sub(r"\\\n\s*", "", blocks).splitlines()
    return [re.split(r"\s{3,}|\s#\s", line)[0].strip() for line in lines]


def commands(document: str) -> list[str]:
    """Every call of the `giirl` command that a document shows."""
    return [text for text in (*spans(document), *shell_lines(document)) if re.match(r"giirl [a-z]", text)]


def resolve(words: list[str]) -> tuple[click.Command, list[str]]:
    """The command that these words name, and the words after it; KeyError for a word that names none."""
    command: click.Command = giirl
    while isinstance(command, click.Group) and words and words[0].islower():
        command, words = command.commands[words[0]], words[1:]
    return command, words


def mistakes(command: str) -> list[str]:
    """What in a call of `giirl` does not exist: a command, an option or a setting."""
    found = []
    alternatives = re.search(r"[a-z-]+(?:\|[a-z-]+)+", command)
    for name in alternatives.group().split("|") if alternatives else [""]:
        words = shlex.split(command.replace(alternatives.group(), name) if alternatives else command)[1:]
        try:
            known, rest = resolve(words)
        except KeyError as error:
            found.append(f"no command {error} in: {command}")
            continue
        some = known.commands.values() if isinstance(known, click.Group) else [known]  # NAME stands for any of them
        options = {option for one in some for parameter in one.params for option in parameter.opts}
        found += [f"no option {word} in: {command}" for word in rest if word.startswith("--") and word not in options]
        settings = [match.group(1) for word in rest if (match := SETTING.fullmatch(word))]
        found += [f"no setting {key} in: {command}" for key in settings if key not in keys()]
    return found


def anchors(document: Path) -> set[str]:
    """The headings of a document as GitHub links to them."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def schema() -> dict[str, Any]:
    return TypeAdapter(Config).json_schema()


@pytest.mark.parametrize("document", DOCUMENTS)
def test_no_line_of_a_document_is_longer_than_a_line_of_code(document: str) -> None:
    lines = read(document).splitlines()
    assert [f"{document}:{i}" for i, line in enumerate(lines, 1) if len(line) > MAX_COLUMNS] == []


def test_the_readme_fits_in_one_reading() -> None:
    assert len(read("README.md").splitlines()) <= MAX_README_LINES


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_relative_link_points_to_a_file_and_a_heading_that_exist(document: str) -> None:
    text = " ".join(prose(document).split())
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        name, _, anchor = target.partition("#")
        file = (ROOT / document).parent / name if name else ROOT / document
        if "://" in target:
            continue
        if not file.exists() or (anchor and anchor not in anchors(file)):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_command_in_a_document_exists_with_its_options_and_settings(document: str) -> None:
    shown = [] if document == OLD_SETTINGS else commands(document)
    assert [mistake for command in shown for mistake in mistakes(command)] == []


@pytest.mark.parametrize(
    "command",
    ["giirl rewrd serve RUN", "giirl bench wire|tyre", "giirl train --fast", "giirl train x.toml policy.asked=3"],
)
def test_a_command_that_does_not_exist_is_found(command: str) -> None:
    assert len(mistakes(command)) == 1


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_make_target_in_a_document_exists(document: str) -> None:
    targets = set(re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE))
    code = (*spans(document), *shell_lines(document))
    assert {name for text in code for name in re.findall(r"^make ([a-z][a-z-]*)", text)} <= targets


@pytest.mark.parametrize("document", [document for document in DOCUMENTS if document != OLD_SETTINGS])
def test_every_setting_in_a_document_exists(document: str) -> None:
    sections = {key for key, value in schema()["properties"].items() if "$ref" in value}
    named = set()
    for span in spans(document):
        if document not in PYTHON_API and SETTING.fullmatch(span):
            named.add(span.partition("=")[0])
        for word in span.split():
            key = word.partition("=")[0]
            if re.fullmatch(r"[a-z_]+\.[a-z_]+", key) and key.partition(".")[0] in sections:
                named.add(key)
    files = {name for name in named if name.endswith((".json", ".md", ".py", ".safetensors"))}
    assert named - set(keys()) - files - {"key"} == set()


def test_every_new_name_in_the_list_of_renamed_settings_exists() -> None:
    table = read(OLD_SETTINGS).partition("Renamed settings:")[2].partition("Renamed commands")[0]
    new = [row.split("|")[2].partition("=")[0].strip(" `") for row in table.splitlines() if row.startswith("| `")]
    assert new
    assert [name for name in new if not any(key.endswith(name.removeprefix("*")) for key in keys())] == []


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_file_of_the_project_that_a_document_names_exists(document: str) -> None:
    paths = [path for span in spans(document) for path in re.findall(rf"^(?:{FOLDERS})/[\w./-]*$", span)]
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_algorithms_page_has_every_algorithm_and_form() -> None:
    names = schema()["properties"]["algorithm"]["enum"]
    headings = anchors(ROOT / "docs/algorithms.md")
    assert [name for name in names if name not in headings] == []
    discriminator = schema()["$defs"]["DiscriminatorConfig"]["properties"]
    forms = [*discriminator["reward"]["enum"], *discriminator["form"]["enum"]]
    page = spans("docs/algorithms.md")
    assert [form for form in forms if form not in page] == []


def test_the_metrics_page_has_every_prometheus_series_with_its_help_text() -> None:
    page = " ".join(read("docs/metrics.md").split())
    families = [family for family in Metrics().registry.collect() if family.name.startswith("giirl_")]
    names = {family.name + ("_total" if family.type == "counter" else ""): family for family in families}
    wanted = [f"`{name}` ({family.type}): {family.documentation.removesuffix('.')}." for name, family in names.items()]
    assert [text for text in wanted if text not in page] == []
    assert set(re.findall(r"\bgiirl_[a-z_]+\b", page)) <= set(names), "series that do not exist any more"


def test_the_metrics_page_has_every_label() -> None:
    series = [value for value in vars(Metrics()).values() if isinstance(value, Counter | Gauge | Histogram)]
    labels = {label for one in series for label in one._labelnames}
    assert labels - set(spans("docs/metrics.md")) == set()


@pytest.mark.parametrize("algorithm", ["giirl", "cloning", "sqil"])
def test_the_metrics_page_has_every_key_of_a_run(algorithm: str, tmp_path: Path) -> None:
    result = run(tmp_path / "run", "iterations=2", "discriminator.gradient_penalty=1", f"algorithm={algorithm}")
    points = [json.loads(line) for line in (tmp_path / "run/curve.jsonl").read_text().splitlines()]
    keys_shown = set(spans("docs/metrics.md"))
    assert {key for point in points for key in point} | set(result) <= keys_shown
    assert {key for row in result["tasks"].values() for key in row} <= keys_shown


@pytest.mark.parametrize("algorithm", ["giirl", "cloning"])
def test_the_metrics_page_has_every_key_of_a_grid_curve(algorithm: str) -> None:
    changes = ["iterations=2", "rollout_batch=2", "policy.updates=2", "grid.random_episodes=5", "grid.measure_every=1"]
    curve = learn(load_config(ROOT / "experiments/gridcraft.toml", [*changes, f"algorithm={algorithm}"])).curve
    assert {key for point in curve for key in point} <= set(spans("docs/metrics.md"))


def test_the_reward_page_has_the_version_of_exported_rewards() -> None:
    assert f"| `schema` | {SCHEMA}: " in (ROOT / "docs/reward.md").read_text(encoding="utf-8")


def test_no_old_name_is_left() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    left = []
    for name in listed.splitlines():
        path = ROOT / name
        if path.suffix not in (".py", ".js", ".md", ".toml", ".html", ".css", ".yml", ".sh") or not path.is_file():
            continue
        if name in OLD_NAMES_LISTED:
            continue
        lines = path.read_text().splitlines()
        left += [
            f"{name}:{number}: {match.group()}"
            for number, line in enumerate(lines, 1)
            for old in OLD_NAMES
            if (match := old.search(line))
        ]
    assert left == []
