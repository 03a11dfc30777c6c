"""The public surface: what each package exports, what an import loads, and which extra installs what."""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from packaging.utils import canonicalize_name

from giirl.cli import main
from tests.test_frame import PACKAGES, ROOT, imports, name, requirements, sources

PUBLIC = ("actors", "browser_farm", "giirl", "giirl_core", "gridcraft", "learner", "reward_service")
CORE = "giirl_core"  # its types and settings are exported again by the packages whose users need them
BORROWERS = ("browser_farm", "giirl")
HEAVY = ("PIL", "matplotlib", "miniwob", "ray", "selenium", "torch", "websocket", "zmq")
OF_ANOTHER = {"urllib3": "selenium"}  # selenium raises its exceptions
LAZY = tuple(package for package in PUBLIC if package != "gridcraft")  # its modules are few and light
DEADLINE_S = 60.0

# Fails every import of the packages whose names are in sys.argv[1], as where they are not installed.
WITHOUT = """
import importlib, json, sys

MISSING = json.loads(sys.argv.pop(1))


class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in MISSING:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Missing())
"""


def fresh(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python code in an interpreter that has imported nothing."""
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT)


def loaded(code: str) -> set[str]:
    """The modules in sys.modules after this code has run in a fresh interpreter."""
    ended = fresh(f"{code}\nprint(*sys.modules)")
    assert ended.returncode == 0, ended.stderr
    return set(ended.stdout.split())


def modules_of(*packages: str) -> list[str]:
    """Every module of these packages."""
    paths = [path.relative_to(ROOT).with_suffix("") for path in sources(*packages)]
    return [".".join(path.parts).removesuffix(".__init__") for path in paths if path.name != "__main__"]


def public_imports(package: str) -> dict[str, str]:
    """Name -> module of the public names that a package's __init__ imports, under TYPE_CHECKING if it is lazy."""
    body = ast.parse((ROOT / package / "__init__.py").read_text()).body
    if package in LAZY:
        blocks = [node for node in body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
        body = [node for block in blocks for node in block.body]
    found = [node for node in body if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGES)]
    return {alias.asname or alias.name: node.module or "" for node in found for alias in node.names}


def optional() -> dict[str, str]:
    """Distribution -> extra of every package outside the base that a user may need."""
    groups = {extra: group for extra, group in requirements().items() if extra not in ("", "dev")}
    return {canonicalize_name(r.name): extra for extra, group in groups.items() for r in group}


@pytest.mark.parametrize("package", PUBLIC)
def test_every_public_name_can_be_imported_from_its_package(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__all__
    modules = public_imports(package)
    assert set(module.__all__) == set(modules)
    for exported in module.__all__:
        assert getattr(module, exported) is getattr(importlib.import_module(modules[exported]), exported)
        assert exported in dir(module)


@pytest.mark.parametrize("package", LAZY)
def test_type_checkers_see_the_same_public_names_as_the_interpreter(package: str) -> None:
    assert public_imports(package) == importlib.import_module(package)._MODULES


@pytest.mark.parametrize("package", PUBLIC)
def test_every_package_tells_type_checkers_that_it_is_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()  # without it they ignore an installed package's types (PEP 561)


@pytest.mark.parametrize("package", PUBLIC)
def test_a_package_exports_only_what_its_own_modules_define_or_the_core(package: str) -> None:
    allowed = (package, CORE) if package in BORROWERS else (package,)
    for module in public_imports(package).values():
        assert module.split(".")[0] in allowed
        assert module in modules_of(*allowed)


@pytest.mark.parametrize("package", PUBLIC)
def test_an_unknown_name_is_an_attribute_error_that_names_the_package(package: str) -> None:
    module = importlib.import_module(package)
    with pytest.raises(AttributeError, match=f"'{package}' has no attribute 'nonsense'"):
        _ = module.nonsense


@pytest.mark.parametrize("package", PUBLIC)
def test_importing_a_package_loads_nothing_heavy(package: str) -> None:
    assert [module for module in loaded(f"import {package}") if module in HEAVY] == []


@pytest.mark.parametrize("package", LAZY)
def test_importing_a_package_loads_none_of_its_modules(package: str) -> None:
    found = loaded(f"import {package}")
    assert [module for module in found if "." in module and module.split(".")[0] in PACKAGES] == []


def test_the_values_of_the_farm_load_neither_chrome_tools_nor_torch_nor_ray() -> None:
    found = loaded("from browser_farm import Action, Command, EpisodeSpec, FakeFarm, Goal, Page, Verb")
    assert [module for module in found if module in HEAVY] == []
    assert "browser_farm.chrome" not in found


def test_importing_browser_farm_and_gridcraft_registers_their_environments() -> None:
    ended = fresh(
        "import browser_farm, gridcraft, gymnasium\n"
        "print(*(gymnasium.spec(f'giirl/{name}-v0').id for name in ('MiniWoB', 'LanguageGridCraft')))"
    )
    assert ended.stdout.split() == ["giirl/MiniWoB-v0", "giirl/LanguageGridCraft-v0"]


def test_every_package_and_subpackage_says_in_a_docstring_what_lives_there() -> None:
    first_lines = {
        name(path): (ast.get_docstring(ast.parse(path.read_text())) or "").partition("\n")[0]
        for path in sources(*PACKAGES)
        if path.name == "__init__.py"
    }
    assert {path: line for path, line in first_lines.items() if len(line.split()) < 5 or line[-1] not in ".?"} == {}


def test_the_farm_and_the_grid_import_no_optional_package() -> None:
    modules = modules_of("browser_farm", "gridcraft")
    ended = fresh(f"{WITHOUT}\nfor module in {modules}: importlib.import_module(module)", json.dumps(list(main.EXTRAS)))
    assert ended.returncode == 0, ended.stderr


def test_every_imported_package_is_a_dependency() -> None:
    declared = {canonicalize_name(r.name) for extra, group in requirements().items() if extra != "dev" for r in group}
    distributions = importlib.metadata.packages_distributions()
    imported = {module.split(".")[0] for path in sources(*PACKAGES) for module in imports(path)}
    others = imported - set(sys.stdlib_module_names) - set(PACKAGES) - {"tests"}
    undeclared = {
        module
        for module in others - set(OF_ANOTHER)
        if not declared & {canonicalize_name(found) for found in distributions.get(module, [])}
    }
    assert undeclared == set()
    assert set(OF_ANOTHER) <= others


def test_no_package_is_in_two_extras() -> None:
    listed = [canonicalize_name(r.name) for group in requirements().values() for r in group]
    assert len(listed) == len(set(listed))


def test_the_extra_all_has_every_extra_except_dev() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    assert f'all = ["giirl[{",".join(extra for extra in requirements() if extra not in ("", "dev"))}]"]' in text


def test_the_command_knows_the_extra_of_every_optional_package() -> None:
    distributions = importlib.metadata.packages_distributions()
    known = {canonicalize_name(distributions[module][0]): extra for module, extra in main.EXTRAS.items()}
    assert known == optional()


@pytest.mark.parametrize("module", sorted(main.EXTRAS))
def test_a_missing_optional_package_is_reported_in_one_line_with_its_extra(
    module: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(**options: Any) -> None:
        raise ModuleNotFoundError(f"No module named '{module}.part'", name=f"{module}.part")

    monkeypatch.setattr(main, "giirl", command)
    monkeypatch.setattr("signal.signal", lambda number, handler: None)
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert ended.value.code == 1
    assert capsys.readouterr().err == (
        f"giirl: this command needs {module}, which is not installed: pip install 'giirl[{main.EXTRAS[module]}]'\n"
    )


def test_a_missing_package_that_no_extra_installs_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def command(**options: Any) -> None:
        raise ModuleNotFoundError("No module named 'nonsense'", name="nonsense")

    monkeypatch.setattr(main, "giirl", command)
    monkeypatch.setattr("signal.signal", lambda number, handler: None)
    with pytest.raises(ModuleNotFoundError):
        main.main()


RUN = f"{WITHOUT}\nfrom giirl.cli.main import main\nmain()"


@pytest.mark.parametrize("words", [["--help"], ["train", "--help"], ["demos", "stats", "--help"], ["--version"]])
def test_the_command_starts_with_the_base_alone(words: list[str]) -> None:
    ended = fresh(RUN, json.dumps(list(main.EXTRAS)), *words)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize(
    ("missing", "extra", "words"),
    [
        (["torch"], "train", ["train", "run={run}", "runtime=serial", "browser=fake"]),
        (["ray"], "cluster", ["train", "run={run}", "browser=fake", "net.vectors=hashed"]),
        (["matplotlib"], "report", ["train", "experiments/gridcraft.toml", "run={run}"]),
        (["psutil"], "bench", ["bench", "farm"]),
    ],
)
def test_a_command_without_its_extra_leaves_one_line_and_no_run_folder(
    missing: list[str], extra: str, words: list[str], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    ended = fresh(RUN, json.dumps(missing), *(word.format(run=run) for word in words))
    assert ended.returncode == 1
    last = ended.stderr.splitlines()[-1]
    assert last == f"giirl: this command needs {missing[0]}, which is not installed: pip install 'giirl[{extra}]'"
    assert not run.exists()


def test_training_on_pages_in_one_thread_needs_the_extra_train_alone(tmp_path: Path) -> None:
    missing = [module for module, extra in main.EXTRAS.items() if extra != "train"]
    modules = ["giirl.run.api", "giirl.run.train", "giirl.run.evaluate"]
    ended = fresh(f"{WITHOUT}\nfor module in {modules}: importlib.import_module(module)", json.dumps(missing))
    assert ended.returncode == 0, ended.stderr
