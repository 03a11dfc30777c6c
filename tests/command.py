"""The `giirl` command as a fixture: it is called in this process, in an empty folder."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from giirl.cli.main import main


@dataclass(frozen=True, slots=True, kw_only=True)
class Completed:
    """Exit status and output of a command."""

    status: int
    out: str
    err: str

    @property
    def error(self) -> str:
        """The error message, which must be the only one and the last line."""
        lines = [line for line in self.err.splitlines() if line.startswith("giirl: ")]
        assert self.status not in (0, None)
        assert len(lines) == 1, self.err
        assert "Traceback" not in self.err
        assert self.err.endswith(lines[0] + "\n")
        return lines[0]


Command = Callable[..., Completed]


@pytest.fixture
def giirl(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> Iterator[Command]:
    """Runs `giirl WORDS...` in an empty folder."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    monkeypatch.chdir(tmp_path)

    def command(*words: str | Path) -> Completed:
        monkeypatch.setattr(sys, "argv", ["giirl", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        output = capfd.readouterr()
        assert isinstance(ended.value.code, int)
        return Completed(status=ended.value.code, out=output.out, err=output.err)

    yield command
    for number, handler in handlers.items():
        signal.signal(number, handler)
