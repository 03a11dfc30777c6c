"""Log lines: what is in them, and that none is written twice or in parts."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterator

import pytest

from giirl_core.telemetry.logs import configure_logs

LOG = logging.getLogger("giirl.test")


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    root = logging.getLogger()
    before = list(root.handlers)
    yield
    root.handlers = before


def test_a_warning_is_one_line_with_time_level_run_and_process(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs("text", "four-1a2b", "actor-3")
    LOG.warning("rejected policy weights:\n  version %d", 7)
    LOG.info("not shown")
    line = capsys.readouterr().err
    pattern = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z WARNING four-1a2b actor-3: rejected policy weights: version 7\n"
    assert re.fullmatch(pattern, line)


def test_a_collector_of_logs_gets_one_json_object_for_each_warning(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs("json", "four-1a2b", "learner")
    try:
        raise OSError("no space left")
    except OSError:
        LOG.exception("cannot save\n")
    fields = json.loads(capsys.readouterr().err)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT[\d:.]+Z", fields.pop("time"))
    assert fields == {
        "level": "ERROR",
        "run": "four-1a2b",
        "process": "learner",
        "message": "cannot save\n: OSError('no space left')",
    }


def test_a_second_run_in_a_process_writes_no_line_twice(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs("text", "first", "learner")
    configure_logs("text", "second", "learner")
    LOG.warning("once")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert " second learner: once" in lines[0]
