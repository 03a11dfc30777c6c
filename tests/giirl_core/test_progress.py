"""Lines of progress in a log file, and durations."""

from __future__ import annotations

import re

import pytest
from rich.table import Table

from giirl_core.progress import Display, duration, visible


def test_a_line_of_progress_has_a_time_stamp_the_rest_of_the_time_and_the_note(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    now_s = [1000.0]
    monkeypatch.setattr("giirl_core.progress.time.monotonic", lambda: now_s[0])
    with Display().job("training", 300, done=100) as job:
        now_s[0] += 500.0
        job.advance(0, "behavioural cloning 3/9")  # the rate is that of what follows
        now_s[0] += 60.0
        job.advance(20, "success click-test 74 %")
        job.advance(180)
    first, start, middle, end = capfd.readouterr().err.splitlines()
    assert first == "training ..."
    stamp = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d"
    assert re.fullmatch(rf"{stamp} training 100/300  behavioural cloning 3/9", start)
    assert re.fullmatch(rf"{stamp} training 120/300, 9:00 left  success click-test 74 %", middle)
    assert re.fullmatch(rf"{stamp} training 300/300  ", end)


def test_durations_read_like_a_clock() -> None:
    assert [duration(s) for s in (0.4, 65, 3600 * 5 + 61)] == ["0:00", "1:05", "5:01:01"]


@pytest.mark.parametrize("text", ["[/b] a :smile: [red]b", "\x1b[2J\x07gone\r", "‮reversed", "plain\tä"])
def test_what_a_web_page_wrote_is_neither_markup_nor_obeyed_by_a_terminal(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    table = Table("element")
    table.add_row(text)
    Display().table(table)
    Display().say(text)
    shown = capsys.readouterr()
    for output in (shown.out, shown.err):
        assert visible(text).expandtabs(8).split()[0] in output
        assert not set(output) & set("\x1b\x07\r‮")
