"""What a user gets from `pip install giirl`: the browser farm in real Chrome, without torch and Ray."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.test_frame import ROOT, requirements

DEADLINE_S = 100.0  # of each step; together they take half a minute

EPISODE = """
import sys
import browser_farm
from browser_farm import Action, ChromeFarm, EpisodeSpec, Verb
import gymnasium

env = gymnasium.make("giirl/MiniWoB-v0", task="click-test")
try:
    observed, info = env.reset(seed=7)
    button = next(e for e in observed["dom_elements"] if e["tag"] == "button")
    action = env.unwrapped.create_action("CLICK_ELEMENT", ref=button["ref"])
    observed, reward, terminated, truncated, info = env.step(action)
finally:
    env.close()
print(browser_farm.__file__, reward, terminated, truncated, *(name for name in ("torch", "ray") if name in sys.modules))
"""


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a command outside the source tree, so that only what is installed can be imported."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=DEADLINE_S, check=False
    )


def pip(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    options = ["--no-input", "--disable-pip-version-check", "--quiet", "--retries", "1", "--timeout", "15"]
    return run(folder, str(folder / "venv/bin/python"), "-m", "pip", "install", *options, *words)


def installed(folder: Path) -> Mapping[str, importlib.metadata.Distribution]:
    """Name -> distribution of every package in the virtual environment."""
    packages = [str(path) for path in folder.glob("venv/lib/python*/site-packages")]
    return {found.metadata["Name"].lower(): found for found in importlib.metadata.distributions(path=packages)}


@pytest.mark.chrome
@pytest.mark.slow
@pytest.mark.timeout(3 * DEADLINE_S)
def test_the_base_install_plays_an_episode_in_chrome_without_torch_and_ray(tmp_path: Path) -> None:
    assert run(tmp_path, sys.executable, "-m", "venv", "venv").returncode == 0
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    try:
        reached = pip(tmp_path, *build)
    except subprocess.TimeoutExpired:
        pytest.skip(f"pip did not get the build requirements from a package index within {DEADLINE_S:.0f} s")
    if reached.returncode != 0:
        pytest.skip(f"pip reaches no package index: {(reached.stderr.splitlines() or [''])[-1]}")

    ended = pip(tmp_path, "--no-build-isolation", "-c", str(ROOT / "constraints.txt"), str(ROOT))
    assert ended.returncode == 0, ended.stderr
    packages = installed(tmp_path)
    assert {r.name for r in requirements()[""]} <= set(packages)
    optional = {r.name for extra, group in requirements().items() if extra not in ("", "dev") for r in group}
    assert optional & set(packages) == set()
    extras = packages["giirl"].metadata.get_all("Provides-Extra") or []
    assert set(extras) == {*requirements(), "all"} - {""}
    files = {str(file) for file in packages["giirl"].files or []}
    assert {"giirl_core/nets/wordnet.tsv.gz", "giirl_core/nets/wordnet.LICENSE", "giirl/studies/published.csv"} <= files

    played = run(tmp_path, str(tmp_path / "venv/bin/python"), "-c", EPISODE)
    assert played.returncode == 0, played.stderr
    file, *outcome = played.stdout.split()
    assert tmp_path in Path(file).parents
    assert outcome == ["1.0", "True", "False"]

    command = run(tmp_path, str(tmp_path / "venv/bin/giirl"), "train", "runtime=serial")
    assert command.returncode == 1
    assert command.stderr.count("\n") == 1
    assert command.stderr.endswith("which is not installed: pip install 'giirl[train]'\n")
