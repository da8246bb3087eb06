"""What makes the runs: one interface, and the processes of this computer behind it."""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any, Protocol

from edmsim.errors import InputError

ATTEMPTS = 3
"""How often a job is begun whose process or computer is lost, before it counts as failed (ours)."""
Function = Callable[[Any], Any]
"""What is done with a job: a function of a module that every computer has; job and answer can be pickled."""


class Lost:
    """Stands for the answer to a job whose process or computer was lost each time; says why."""

    def __init__(self, why: str) -> None:
        self.why = f"{why}; given up after {ATTEMPTS} attempts"


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Engine(Protocol):
    """Where jobs are done.

    An engine takes jobs from the iterator only as it gets them done, so a table of any length waits where it is
    (back-pressure), and answers in the order in which they are done. The function does not raise.
    """

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """Yield each job with its answer, or with `Lost`; what is left is given up when the iterator is closed."""
        ...


class Processes:
    """The processors of this computer, a process for each.

    Parameters
    ----------
    count : int, optional
        Processes; as many as there are processors that may be used, if not given.

    Raises
    ------
    InputError
        Fewer than one.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = processors() if count is None else count
        if self.count < 1:
            raise InputError(f"{self.count} processes make no run: give 1 or more")

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """See `Engine.done`; the first job is done alone, so that what is compiled is compiled once."""
        answers: queue.SimpleQueue[tuple[Any, Any]] = queue.SimpleQueue()
        workers: list[_Worker] = []
        busy, most = 0, 1
        try:
            for job in jobs:
                idle = next((worker for worker in workers if not worker.busy), None)
                if idle is None:
                    idle = _Worker(function, answers)
                    workers.append(idle)
                idle.give(job)
                busy += 1
                if busy == most:
                    yield answers.get()
                    busy, most = busy - 1, self.count
            for _ in range(busy):
                yield answers.get()
        finally:
            for worker in workers:
                worker.stop()


class _Worker:
    """A process, and a thread that talks to it; a process that dies is replaced, and its job begun again."""

    def __init__(self, function: Function, answers: queue.SimpleQueue[tuple[Any, Any]]) -> None:
        self._name = f"{function.__module__}:{function.__qualname__}"
        self._answers = answers
        self._jobs: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False
        self.busy = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def give(self, job: Any) -> None:
        """Let the process do a job."""
        self.busy = True
        self._jobs.put((job,))

    def stop(self) -> None:
        """End thread and process, whatever they do."""
        self._stopped = True
        self._jobs.put(None)
        if (process := self._process) is not None:
            process.kill()
        self._thread.join()

    def _serve(self) -> None:
        while (given := self._jobs.get()) is not None and not self._stopped:
            answer = self._answered(given[0])
            self.busy = False
            self._answers.put((given[0], answer))
        self._end()

    def _answered(self, job: Any) -> Any:
        why = ""
        for _ in range(ATTEMPTS):
            process = self._process = self._process or self._begin()
            if self._stopped:
                break
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                pickle.dump(job, process.stdin)
                process.stdin.flush()
                return pickle.load(process.stdout)
            except (EOFError, OSError, pickle.UnpicklingError):
                self._end()
                why = f"the process that made the run ended with status {process.returncode}"
        return Lost(why)

    def _begin(self) -> subprocess.Popen[bytes]:
        # what this process can import, a worker can; a library's own threads would only wait for each other
        path = os.pathsep.join(place or os.getcwd() for place in sys.path)
        environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(
            [sys.executable, "-m", "edmsim.sweep.worker", self._name], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, env=environment, start_new_session=True,
        )  # fmt: skip

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()
        process.wait()
