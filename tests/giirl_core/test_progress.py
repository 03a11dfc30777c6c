"""Lines of progress in a log file, and durations."""

from __future__ import annotations

import re

import pytest

from giirl_core.progress import Display, duration


def test_a_line_of_progress_has_a_time_stamp_the_rest_of_the_time_and_the_note(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    now_s = [1000.0]
    monkeypatch.setattr("giirl_core.progress.time.monotonic", lambda: now_s[0])
    with Display().job("training", 300, done=100) as job:
        now_s[0] += 60.0
        job.advance(20, "success click-test 74 %")
        job.advance(180)
    first, middle, end = capfd.readouterr().err.splitlines()
    assert first == "training ..."
    stamp = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d"
    assert re.fullmatch(rf"{stamp} training 120/300, 9:00 left  success click-test 74 %", middle)
    assert re.fullmatch(rf"{stamp} training 300/300  ", end)


def test_durations_read_like_a_clock() -> None:
    assert [duration(s) for s in (0.4, 65, 3600 * 5 + 61)] == ["0:00", "1:05", "5:01:01"]
