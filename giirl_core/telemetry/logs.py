"""Log lines with time, level, run and process: as text, or as JSON for a collector of logs."""

from __future__ import annotations

import json
import logging
import sys
import time

FORMS = ("text", "json")


class LogFormatter(logging.Formatter):
    """One line for each record, whatever its message contains. Times are UTC, to the millisecond."""

    def __init__(self, form: str, run: str, process: str) -> None:
        assert form in FORMS
        super().__init__()
        self._form, self._run, self._process = form, run, process

    def format(self, record: logging.LogRecord) -> str:
        moment = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{int(record.msecs):03d}Z"
        message = record.getMessage()
        if record.exc_info:
            message += f": {record.exc_info[1]!r}"
        if self._form == "json":
            fields = {"time": moment, "level": record.levelname, "run": self._run, "process": self._process}
            return json.dumps({**fields, "message": message})
        where = " ".join(filter(None, (self._run, self._process)))
        return f"{moment} {record.levelname} {where}: {' '.join(message.split())}"


class _Handler(logging.Handler):
    """Writes to what is the standard error now: a progress bar replaces it while it is shown."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            sys.stderr.write(self.format(record) + "\n")
            sys.stderr.flush()
        except (OSError, ValueError):  # nobody reads it any more
            self.handleError(record)


def configure_logs(form: str, run: str, process: str) -> None:
    """Write the warnings of this process to standard error; another call replaces the former."""
    handler, root = _Handler(), logging.getLogger()
    handler.setFormatter(LogFormatter(form, run, process))
    root.handlers = [*(other for other in root.handlers if not isinstance(other, _Handler)), handler]
