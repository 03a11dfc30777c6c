"""Runs the miniwob package's own tests on our environment: by default, and in real time.

    python -m benchmarks.original_suite [--mode NAME ...] [--sdist FILE] [--json FILE]

The tests are those of the installed version's source distribution, which pip downloads. They call
`gymnasium.make("miniwob/X-v1", ...)`, which makes our environment instead. Two of the files are left out: `test_api.py`
needs a module that the distribution lacks, and `test_selenium_instance.py` tests the package's launch of Chrome. The
exit status is 1 when a test fails that is not in ANSWERED_DIFFERENTLY.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tarfile
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import click

from giirl_core.files import write_json

ROOT = Path(__file__).parents[1]
FILES = ("test_action.py", "test_environment.py", "test_spaces.py")
MODES: dict[str, dict[str, Any]] = {"default": {}, "real_time": {"real_time": True}}
NO_LIMIT, NO_SCALING = "an episode has no time limit", "the reward does not shrink with time"
# Tests that the default mode answers differently, and why.
ANSWERED_DIFFERENTLY = {
    "test_environment.py::TestMiniWoBEnvironment::test_timeout": NO_LIMIT,
    "test_environment.py::TestMiniWoBEnvironment::test_screenshot": "without record_screenshots=True it is black",
    "test_environment.py::TestGetOriginalReward::test_get_original_reward[numbers0-1.0]": NO_SCALING,
    "test_environment.py::TestGetOriginalReward::test_get_original_reward[numbers1-0.4]": NO_SCALING,
}


# The conftest.py of the tests: `gymnasium.make` answers for the package's names.
REPLACEMENT = """
import browser_farm, gymnasium

make = gymnasium.make

def make_ours(name, **options):
    return make("giirl/MiniWoB-v0", task=name.removeprefix("miniwob/").removesuffix("-v1"), **OPTIONS, **options)

gymnasium.make = make_ours
"""


def download(folder: Path) -> Path:
    """The source distribution of the installed miniwob package, fetched by pip."""
    name = f"miniwob=={version('miniwob')}"
    command = ["pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:", "--dest", str(folder), name]
    subprocess.run([sys.executable, "-m", *command], check=True)
    return next(folder.glob("miniwob-*.tar.gz"))


def extract_tests(sdist: Path, folder: Path) -> list[Path]:
    """The test files of a source distribution, written into `folder`."""
    with tarfile.open(sdist) as archive:
        for member in archive.getmembers():
            path = Path(member.name)
            if path.parent.name == "tests" and path.name in FILES:
                source = archive.extractfile(member)
                assert source is not None, "it is a file"
                (folder / path.name).write_bytes(source.read())
    return [folder / name for name in FILES]


def run_tests(files: list[Path], options: dict[str, Any]) -> dict[str, str]:
    """The outcome of each test with these options of our environment: "passed", or its error."""
    folder = files[0].parent
    report = folder / "report.xml"
    (folder / "pytest.ini").write_text("[pytest]\njunit_family = xunit2\n", encoding="utf-8")
    (folder / "conftest.py").write_text(f"OPTIONS = {options!r}\n{REPLACEMENT}", encoding="utf-8")
    arguments = ["-q", "--tb=short", "-p", "no:cacheprovider", f"--junitxml={report}", "-c", str(folder / "pytest.ini")]
    command = [sys.executable, "-m", "pytest", *arguments, *map(str, files)]
    subprocess.run(command, env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}, check=False)
    outcomes = {}
    for case in ElementTree.parse(report).iter("testcase"):
        module, _, name = case.attrib["classname"].partition(".")
        errors = [found.attrib.get("message", found.tag) for found in case if found.tag in ("failure", "error")]
        outcomes[f"{module}.py::{name}::{case.attrib['name']}"] = errors[0].splitlines()[0] if errors else "passed"
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--mode", action="append", choices=MODES, help="may be repeated; default: both")
    parser.add_argument("--sdist", type=Path, help="the package's source distribution, instead of downloading it")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sdist = arguments.sdist or download(Path(folder))
        files = extract_tests(sdist, Path(folder))
        found = {mode: run_tests(files, MODES[mode]) for mode in arguments.mode or MODES}
    modes = {mode: summary(mode, outcomes) for mode, outcomes in found.items()}
    result = {
        "command": " ".join(["python -m benchmarks.original_suite", *sys.argv[1:]]),
        "python": platform.python_version(),
        "miniwob": version("miniwob"),
        "modes": modes,
    }
    for mode, row in modes.items():
        click.echo(f"{mode}: {row['passed']} of {row['tests']} passed, {len(row['unexpected'])} failed unexpectedly")
    if arguments.json:
        write_json(arguments.json, result)
    sys.exit(any(row["unexpected"] or not row["tests"] for row in modes.values()))


def summary(mode: str, outcomes: dict[str, str]) -> dict[str, Any]:
    """Counts, the tests that are answered differently by design, and other failures with their error."""
    failed = {test: outcome for test, outcome in outcomes.items() if outcome != "passed"}
    by_design = ANSWERED_DIFFERENTLY if mode == "default" else {}
    return {
        "tests": len(outcomes),
        "passed": len(outcomes) - len(failed),
        "answered_differently": {test: by_design[test] for test in failed if test in by_design},
        "unexpected": {test: outcome for test, outcome in failed.items() if test not in by_design},
    }


if __name__ == "__main__":
    main()
