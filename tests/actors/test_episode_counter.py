"""An actor's count of finished episodes survives a SIGKILL, and a replaced incarnation cannot add to it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from actors.episode_counter import ENTRY, EpisodeCounter, Replaced


def test_an_actor_numbers_its_episodes_and_its_successor_reads_the_count(tmp_path: Path) -> None:
    with closing(EpisodeCounter(tmp_path / "new/a", 3)) as first:
        assert first.before == ()
        assert [first.add() for _ in range(3)] == [0, 1, 2]
        with closing(EpisodeCounter(tmp_path / "new/a", 5)) as second:
            assert second.before == ((3, 3),)
            assert second.add() == 0
            with pytest.raises(Replaced, match="incarnation 5 has taken over from 3"):
                first.add()
    with closing(EpisodeCounter(tmp_path / "new/a", 6)) as third:
        assert third.before == ((3, 3), (5, 1))


def test_an_incarnation_that_is_not_the_newest_cannot_begin(tmp_path: Path) -> None:
    EpisodeCounter(tmp_path / "a", 4).close()
    for stale in (3, 4):
        with pytest.raises(Replaced, match=f"belongs to incarnation 4, wanted one before {stale}"):
            EpisodeCounter(tmp_path / "a", stale)


def test_settled_counts_are_deleted_and_counting_goes_on(tmp_path: Path) -> None:
    for incarnation in range(3):
        with closing(EpisodeCounter(tmp_path / "a", incarnation)) as counter:
            counter.add()
    with closing(EpisodeCounter(tmp_path / "a", 3)) as counter:
        counter.add()
        counter.forget_before(2)
        assert counter.before == ((2, 1),)
        assert counter.add() == 1
        counter.forget_before(2)
    with closing(EpisodeCounter(tmp_path / "a", 4)) as last:
        assert last.before == ((2, 1), (3, 2))


def test_a_kill_while_the_file_is_shortened_changes_no_count(tmp_path: Path) -> None:
    data = b"".join(ENTRY.pack(*entry) for entry in [(2, 7), (3, 4), (3, 4)])  # written, but not yet truncated
    (tmp_path / "a").write_bytes(data + b"half")
    with closing(EpisodeCounter(tmp_path / "a", 4)) as counter:
        assert counter.before == ((2, 7), (3, 4))
        assert counter.add() == 0


def test_the_count_survives_a_sigkill(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from actors.episode_counter import EpisodeCounter\n"
    code += "counter = EpisodeCounter(Path(sys.argv[1]), 0)\nwhile True: print(counter.add(), flush=True)"
    root = Path(__file__).parent.parent.parent
    command = [sys.executable, "-c", code, str(tmp_path / "a")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=root, text=True) as process:
        assert process.stdout is not None
        for _ in range(100):
            process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)
        printed = [int(line) for line in process.stdout.read().split()]
    with closing(EpisodeCounter(tmp_path / "a", 1)) as successor:
        ((_, finished),) = successor.before
    assert finished - (printed[-1] + 1 if printed else 100) in (0, 1)  # killed before or after it printed the last one
