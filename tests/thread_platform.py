"""A platform that runs actors and reward services as threads instead of Ray processes: one SIGKILL ends all of them.

Sockets, messages and the code of `actors.process` and `reward_service.process` are real.
"""

from __future__ import annotations

from concurrent.futures import Future, TimeoutError
from threading import Thread
from typing import Any

from giirl_core.processes.supervision import Place, ProcessDied


class ThreadCall:
    def __init__(self, method: Any, values: tuple[Any, ...]) -> None:
        self._future: Future[Any] = Future()
        Thread(target=self._run, args=(method, values), daemon=True).start()

    def _run(self, method: Any, values: tuple[Any, ...]) -> None:
        try:
            self._future.set_result(method(*values))
        except Exception as error:  # noqa: BLE001 - `result` raises it
            self._future.set_exception(error)

    def done(self) -> bool:
        return self._future.done()

    def result(self, timeout_s: float) -> Any:
        try:
            return self._future.result(timeout_s)
        except TimeoutError:
            raise ProcessDied(f"no answer within {timeout_s} s") from None
        except Exception as error:
            raise ProcessDied(f"{type(error).__name__}: {error}") from error


class ThreadProcess:
    reattached = False

    def __init__(self, worker: Any) -> None:
        self._worker = worker

    def placed(self) -> bool:
        return True

    def call(self, method: str, *values: Any) -> ThreadCall:
        return ThreadCall(getattr(self._worker, method), values)

    def kill(self) -> None:
        """A thread cannot be killed: it goes on, and another one takes its place."""


class ThreadPlatform:
    """With `single_node=False` processes behave as on a cluster: encrypted connections, temporary files."""

    host = node = "127.0.0.1"

    def __init__(self, *, single_node: bool = True) -> None:
        self.single_node = single_node

    def start(
        self, kind: type[Any], name: str, *values: Any, place: Place, threads: int = 0, detached: bool = True
    ) -> ThreadProcess:
        return ThreadProcess(kind(*values))

    def share(self, value: Any) -> Any:
        return value

    def resources(self) -> str:
        return "threads"

    def close(self) -> None:
        return
