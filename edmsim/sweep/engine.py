"""What makes the runs: one interface, and behind it the processes of this computer or those of a Ray cluster.

A cluster needs the extra ``cluster``.
"""

from __future__ import annotations

import logging
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

ATTEMPTS = 3  # how often a job is begun whose process or computer is lost, before it counts as failed (ours)
Function = Callable[[Any], Any]
"""What is done with a job: a function of a module that every computer has; job and answer can be pickled."""


class LostJob:
    """Stands for the answer to a job whose process or computer was lost each time; says why."""

    def __init__(self, why: str) -> None:
        self.why = f"{why}; given up after {ATTEMPTS} attempts"


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Engine(Protocol):
    """Runs the jobs of a sweep.

    An engine takes jobs from the iterator only as it finishes others (back-pressure), and yields answers in the
    order in which jobs finish. The function must not raise.
    """

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """Yield each job with its answer or `LostJob`; closing the iterator drops the remaining jobs."""
        ...


class Processes:
    """Runs jobs in processes on this computer.

    Parameters
    ----------
    count : int, optional
        Number of processes; by default one per available processor.

    Raises
    ------
    InputError
        If `count` is below 1.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = processors() if count is None else count
        if self.count < 1:
            raise InputError(f"{self.count} processes make no run: give 1 or more")

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """See `Engine.done`; the first job runs alone, which avoids compiling the same code twice."""
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
        """Run a job in the process."""
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
        while (numbered := self._jobs.get()) is not None and not self._stopped:
            answer = self._answered(numbered[0])
            self.busy = False
            self._answers.put((numbered[0], answer))
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
        return LostJob(why)

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


IN_FLIGHT = 2
"""Jobs handed out per processor (ours): one that runs, and one that waits there while the answer travels."""
LOOK_S = 2.0  # how often, at least, it is looked how many processors there are


class Cluster:
    """Runs jobs on a Ray cluster, one per processor.

    Every computer needs this version of edmsim, and the files of the runs (programs, your constants and
    controllers) at the same paths: in a shared folder or Ray's working directory. Only this process writes results.

    Parameters
    ----------
    address : str
        ``HOST:PORT``, or ``"auto"`` for the cluster that this computer belongs to.

    Raises
    ------
    InputError
        If Ray is not installed, or the cluster is not found.
    """

    def __init__(self, address: str = "auto") -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no usage statistics unless the user asks
        # Ray will change who hides the GPUs; runs use none
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        try:
            import ray
        except ImportError as error:
            raise InputError(f"a cluster needs {error.name}: pip install 'edmsim[cluster]'") from None
        self._ray: Any = ray
        if not ray.is_initialized():
            try:
                host = address.rpartition(":")[0]
                # of a cluster within one computer Ray would ask at the address other computers know it by
                here: dict[str, Any] = {"_node_ip_address": host} if host.startswith("127.") else {}
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **here)
            except (ConnectionError, ValueError, RuntimeError) as error:
                reason = str(error).split(". ")[0]
                raise InputError(f"there is no Ray cluster at '{address}' ({reason}); start one: ray start") from None

    @property
    def count(self) -> int:
        """Number of processors that the cluster has now."""
        return max(int(self._ray.cluster_resources().get("CPU", 0)), 1)

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """See `Engine.done`; if a computer is lost, its jobs start again on another."""
        ray = self._ray
        remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1, scheduling_strategy="SPREAD")(function)
        waiting = iter(jobs)
        out: dict[Any, Any] = {}
        more = True
        try:
            while True:
                while more and len(out) < IN_FLIGHT * self.count:
                    try:
                        job = next(waiting)
                    except StopIteration:
                        more = False
                    else:
                        out[remote.remote(job)] = job
                if not out:
                    return
                ready, _ = ray.wait(list(out), num_returns=1, timeout=LOOK_S)
                for reference in ready:
                    yield out.pop(reference), self._answer(reference)
        finally:
            for reference in out:
                ray.cancel(reference, force=True)

    def _answer(self, reference: Any) -> Any:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            return LostJob(str(error).strip().split("\n")[0] or type(error).__name__)
