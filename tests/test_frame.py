"""The shape of the code: who imports whom, sizes of files and folders, what text may contain."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
PRODUCT = (
    "actors",
    "browser_farm",
    "giirl",
    "giirl_core",
    "gridcraft",
    "learner",
    "reward_service",
)
PACKAGES = (*PRODUCT, "benchmarks")
FOLDERS = (*PACKAGES, "tests", "deploy", "examples", "experiments", ".ci")
MAX_FILE_LINES = 300
MAX_MODULES = 15  # of a folder, without __init__.py

# A package may import from the packages with a lower number only.
LEVEL = {
    "giirl": 4,
    "benchmarks": 3,
    "actors": 2,
    "learner": 2,
    "reward_service": 2,
    "browser_farm": 1,
    "gridcraft": 1,
    "giirl_core": 0,
}
MODULE_PATH = re.compile(rf"\b(?:{'|'.join(sorted(LEVEL, key=len, reverse=True))})(?:\.\w+)+")

# Files with the path of a module in a string. `__init__.py` registers entry points and lists public names to be loaded
# when they are first used; the others name a package with templates, and the command that made a result or a page.
NAMES_MODULES = {
    "giirl/report/render.py",
    "giirl_core/config_reference.py",
    "benchmarks/gym_equality.py",
    "benchmarks/original_suite.py",
}

# The only module that may import each library that talks to the outside.
SOLE_IMPORTER = {
    "PIL": "browser_farm/chrome/answers.py",
    "fastapi": "reward_service/http_api.py",
    "jinja2": "giirl/report/render.py",
    "matplotlib": "giirl/figures.py",
    "miniwob": "browser_farm/gym/adapter.py",
    "msgpack": "giirl_core/wire/messages.py",
    "prometheus_client": "giirl_core/telemetry/prometheus.py",
    "ray": "giirl_core/processes/ray_platform.py",
    "selenium": "browser_farm/chrome/launcher.py",
    "uvicorn": "giirl_core/processes/web_server.py",
    "websocket": "browser_farm/chrome/devtools.py",
    "zmq": "giirl_core/wire/transport.py",
}
PICKLES = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
REGISTRY_HOSTS = (("pypi", "org"), ("pythonhosted", "org"), ("download", "pytorch", "org"), ("npmjs", "org"))


def sources(*folders: str, suffixes: tuple[str, ...] = (".py",)) -> Iterator[Path]:
    """The files of these folders, the same order every time."""
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and path.suffix in suffixes and "__pycache__" not in path.parts:
                yield path


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imports(path: Path) -> set[str]:
    """Every module a file imports, wherever in the file; `from a import b` counts as a and as a.b."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).parts[: -node.level] if node.level else ()
            module = ".".join((*package, *((node.module,) if node.module else ())))
            found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return found


def exists(module: str) -> bool:
    """True for the path of a module or package of this project."""
    path = ROOT / module.replace(".", "/")
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def named_modules(path: Path) -> set[str]:
    """Every module of this project whose path is in a string of a file; docstrings do not count."""
    tree = ast.parse(path.read_text(), str(path))
    documented = [n for n in ast.walk(tree) if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef)]
    docstrings = {id(n.body[0].value) for n in documented if n.body and isinstance(n.body[0], ast.Expr)}
    texts = [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings
    ]
    return {module for text in texts for module in MODULE_PATH.findall(text) if exists(module)}


def arrows(path: Path) -> set[tuple[str, str]]:
    """(this package, another) for each package that a file imports, anywhere in the file, or names in a string."""
    package = path.relative_to(ROOT).parts[0]
    others = {module.split(".")[0] for module in imports(path) | named_modules(path)}
    return {(package, other) for other in others if other in LEVEL and other != package}


def pickling(path: Path) -> list[str]:
    """Where a file reads or writes pickles."""
    found = [f"import {module}" for module in imports(path) if module.split(".")[0] in PICKLES]
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Attribute) and ast.unparse(node) in ("torch.load", "torch.save"):
            found.append(f"{ast.unparse(node)} at line {node.lineno}")
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle" and ast.unparse(node.value) != "False":
            found.append(f"allow_pickle at line {node.lineno}")
    return found


def decisions() -> str:
    """The part of CONTRIBUTING.md that gives reasons."""
    return (ROOT / "CONTRIBUTING.md").read_text().partition("\n## Decisions\n")[2]


def requirements() -> dict[str, list[Requirement]]:
    """The requirements in pyproject.toml by extra, those of the base under ""; `all` only repeats the others."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = {extra: lines for extra, lines in project["optional-dependencies"].items() if extra != "all"}
    return {extra: [Requirement(r) for r in lines] for extra, lines in {"": project["dependencies"], **extras}.items()}


@pytest.mark.parametrize("library", sorted(SOLE_IMPORTER))
def test_one_module_alone_knows_each_library_that_talks_to_the_outside(library: str) -> None:
    importers = {
        name(path) for path in sources(*PRODUCT) if library in {module.split(".")[0] for module in imports(path)}
    }
    assert importers <= {SOLE_IMPORTER[library]}


def test_no_package_imports_from_a_package_on_its_level_or_above() -> None:
    upward = {
        f"{name(path)} -> {other}"
        for path in sources(*PACKAGES)
        for package, other in arrows(path)
        if LEVEL[other] >= LEVEL[package]
    }
    assert upward == set()


def test_module_paths_are_in_strings_only_where_they_have_to_be() -> None:
    found = {
        name(path): modules
        for path in sources(*PACKAGES)
        if path.name != "__init__.py" and name(path) not in NAMES_MODULES and (modules := named_modules(path))
    }
    assert found == {}


@pytest.mark.parametrize(
    "line",
    [
        "import giirl.cli",
        "def f():\n    from giirl.run.train import train",
        "import_module('giirl.run.train')",
        "run('python -m giirl.cli.main')",
        "f'{x} giirl.cli.main:main'",
    ],
)
def test_an_upward_arrow_is_found_in_each_of_its_forms(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("giirl/run", "giirl/cli", "actors"):
        (tmp_path / package).mkdir(parents=True)
        (tmp_path / package / "__init__.py").write_text("")
    (tmp_path / "giirl/run/train.py").write_text("")
    (tmp_path / "giirl/cli/main.py").write_text("")
    (tmp_path / "actors/guilty.py").write_text(line + "\n")
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    assert arrows(tmp_path / "actors/guilty.py") == {("actors", "giirl")}


def test_actions_have_one_address() -> None:
    importers = {name(path) for path in sources(*PACKAGES, "tests") if "giirl_core.actions" in imports(path)}
    assert importers == {"giirl_core/choices.py", "giirl_core/gestures.py", "giirl_core/types.py"}


def test_no_folder_has_more_than_max_modules() -> None:
    counts: dict[str, int] = {}
    for path in sources(*PACKAGES, "tests"):
        if path.name != "__init__.py":
            counts[name(path.parent)] = counts.get(name(path.parent), 0) + 1
    assert {folder: count for folder, count in counts.items() if count > MAX_MODULES} == {}


def test_no_package_reads_or_writes_pickles() -> None:
    assert {name(path): found for path in sources(*PACKAGES) if (found := pickling(path))} == {}


@pytest.mark.parametrize(
    "line",
    ["import pickle", "from cloudpickle import loads", "torch.load(p)", "np.load(p, allow_pickle=True)"],
)
def test_a_pickle_is_seen_in_each_of_its_guises(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    (tmp_path / "guilty.py").write_text(line + "\n")
    assert pickling(tmp_path / "guilty.py")


def test_a_file_longer_than_one_reading_gives_its_reason_among_the_decisions() -> None:
    reasons = decisions()
    long = {
        name(path): lines
        for path in sources(*FOLDERS, suffixes=(".py", ".js", ".sh"))
        if (lines := len(path.read_text().splitlines())) > MAX_FILE_LINES and f"`{name(path)}`" not in reasons
    }
    assert long == {}


def test_no_text_names_the_host_of_a_package_registry() -> None:
    hosts = [".".join(parts).encode() for parts in REGISTRY_HOSTS]
    files = [path for path in ROOT.iterdir() if path.is_file()]
    for folder in FOLDERS:
        files += [p for p in (ROOT / folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts]
    assert [name(path) for path in files if any(host in path.read_bytes() for host in hosts)] == []


def test_every_dependency_is_pinned_to_a_version_inside_its_range() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    wanted = [requirement for group in requirements().values() for requirement in group]
    wrong = [str(r) for r in wanted if not r.specifier.contains(pins.get(canonicalize_name(r.name), "0"))]
    assert wrong == []


def test_prometheus_accepts_every_path_its_configuration_watches() -> None:
    paths = re.findall(r"^\s*- (\S+\.json)$", (ROOT / "deploy/prometheus.yml").read_text(), re.MULTILINE)
    assert paths
    assert [path for path in paths if "*" in path.rpartition("/")[0]] == []  # a star only in the last part
