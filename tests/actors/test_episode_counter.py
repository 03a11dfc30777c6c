"""How many episodes an actor has finished is known after it was killed, and nobody can add to it later."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from actors.episode_counter import ENTRY, EpisodeCounter, Replaced

WAIT_S = 20.0


def test_an_actor_numbers_its_episodes_and_its_successor_knows_how_many_there_were(tmp_path: Path) -> None:
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


def test_an_incarnation_that_is_not_the_newest_does_not_begin(tmp_path: Path) -> None:
    EpisodeCounter(tmp_path / "a", 4).close()
    for stale in (3, 4):
        with pytest.raises(Replaced, match="wanted one below"):
            EpisodeCounter(tmp_path / "a", stale)


def test_what_is_settled_is_forgotten_and_the_count_goes_on(tmp_path: Path) -> None:
    for incarnation in range(3):
        with closing(EpisodeCounter(tmp_path / "a", incarnation)) as tally:
            tally.add()
    with closing(EpisodeCounter(tmp_path / "a", 3)) as tally:
        tally.add()
        tally.settle(2)
        assert tally.before == ((2, 1),)
        assert tally.add() == 1
        tally.settle(2)
    with closing(EpisodeCounter(tmp_path / "a", 4)) as last:
        assert last.before == ((2, 1), (3, 2))


def test_a_kill_while_it_is_shortened_leaves_every_count_as_it_was(tmp_path: Path) -> None:
    whole = b"".join(ENTRY.pack(*entry) for entry in [(2, 7), (3, 4), (3, 4)])  # written, not yet cut
    (tmp_path / "a").write_bytes(whole + b"half")
    with closing(EpisodeCounter(tmp_path / "a", 4)) as tally:
        assert tally.before == ((2, 7), (3, 4))
        assert tally.add() == 0


def test_a_count_outlives_the_process_that_was_killed(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from actors.episode_counter import EpisodeCounter\n"
    code += "tally = EpisodeCounter(Path(sys.argv[1]), 0)\nwhile True: print(tally.add(), flush=True)"
    root = Path(__file__).parent.parent.parent
    words = [sys.executable, "-c", code, str(tmp_path / "a")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, cwd=root, text=True) as process:
        assert process.stdout is not None
        for _ in range(100):
            process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)
        said = [int(line) for line in process.stdout.read().split()]
    with closing(EpisodeCounter(tmp_path / "a", 1)) as successor:
        ((_, finished),) = successor.before
    assert finished - (said[-1] + 1 if said else 100) in (0, 1)  # killed before or after it said so
