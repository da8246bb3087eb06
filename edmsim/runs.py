"""Many runs: a table of the finished ones, and pools of threads or processes that make the others.

Threads start at once and suit short cuts, because the pulse loop releases Python's lock (GIL). Processes suit long
cuts and users' code, which may crash; those of a Ray cluster need the extra ``cluster``.
"""

import hashlib
import json
import os
import pickle
import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from pkgutil import resolve_name
from traceback import format_exception, print_exc
from typing import Any, BinaryIO, Protocol

from edmsim import errors, files, numeric, user_code

Row = dict[str, Any]
Function = Callable[[Any], Any]
"""The function of jobs: in a module that every computer has; jobs and answers must be picklable."""


@errors.methods_refuse_wrong_types
class RunTable:
    """Finished runs: a row for each by its ``id``, in a file to which rows are appended, or in memory only.

    A row is on the disk before `add` returns, so whenever the process dies, no run that was reported as finished is
    made again.

    Parameters
    ----------
    file : path, optional
        Lines of JSON.
    of : mapping, optional
        What all runs have in common, if their ids do not include it.
    texts : sequence of str
        Texts that every row has.

    Raises
    ------
    InputError
        If the file is damaged, has runs of something else, or cannot be written.
    """

    def __init__(
        self, file: str | Path | None = None, of: Mapping[str, Any] | None = None, texts: Sequence[str] = ("id",)
    ) -> None:
        file = None if file is None else Path(file)
        self.rows: dict[str, Row] = {} if file is None else {row["id"]: row for row in read_rows(file, of, texts)}
        self.file, self._of, self._lock = file, of, threading.Lock()
        if file is not None and file.exists() and not files.remove_unfinished_line(file):
            self.keep(())

    def add(self, row: Row) -> None:
        """Save a finished run; one with the same id is replaced."""
        with self._lock:
            if self.file is not None:
                if not self.file.exists():
                    self.keep(self.rows.values())
                with files.naming(self.file), self.file.open("ab") as opened:
                    opened.write(json.dumps(row).encode() + b"\n")
                    opened.flush()
                    os.fsync(opened.fileno())
            self.rows[row["id"]] = row

    def keep(self, rows: Iterable[Row]) -> None:
        """Replace all rows by these."""
        self.rows = {row["id"]: row for row in rows}
        if self.file is not None:
            lines = [*([] if self._of is None else [{"of": self._of}]), *self.rows.values()]
            with files.replacing(self.file) as partial:
                partial.write_text("".join(json.dumps(line) + "\n" for line in lines))


def read_rows(file: str | Path, of: Mapping[str, Any] | None = None, texts: Sequence[str] = ("id",)) -> list[Row]:
    """Return the rows of a table, also while it grows; each must have `texts`. An incomplete last line is skipped."""
    try:
        lines = Path(file).read_bytes().split(b"\n")[:-1]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except IsADirectoryError:
        raise errors.InputError("this is a folder: name a table of runs in it", file) from None
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            if of is not None and number == 1:
                check_same(row["of"], json.loads(json.dumps(of)), file)
                continue
            if not (isinstance(row, dict) and all(isinstance(row.get(name), str) for name in texts)):
                raise ValueError("not a row of a run")
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            raise errors.InputError(
                f"the journal is damaged ({error}): delete this line to repeat its run", file, number
            ) from None
        rows.append(row)
    return rows


def read_of(file: Path) -> Row:
    """Return what all runs of a table have in common: `of` of `RunTable`."""
    with file.open(encoding="utf-8") as opened:
        found: Row = json.loads(opened.readline())["of"]
    return found


def check_same(before: Mapping[str, Any], now: Mapping[str, Any], file: str | Path) -> None:
    """Refuse a file with runs that were made with other values."""
    for name, value in now.items():
        if before[name] != value:
            reason = f"it has the runs of {name} {before[name]!r}, not {value!r}"
            if name == "files":  # their values are digests
                reason = "one of your files has changed since its runs were made"
            raise errors.InputError(f"{reason}: finish those, give another place, or delete it", file)


def digest(file: str) -> str | None:
    """Return a fingerprint of a file as it is now; None if it cannot be read."""
    try:
        status = Path(file).stat()
        return _digest(file, status.st_mtime_ns, status.st_size)
    except OSError:
        return None


@lru_cache(maxsize=1024)
def _digest(file: str, _time_ns: int, _size: int) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]


def digests_of(values: Iterable[Any]) -> dict[str, str]:
    """Return the digests of all files named in values: program, constants, controller, policy, tables."""
    named: dict[str, str] = {}
    found_in, modules = [*values], list[Path]()
    for value in found_in:
        if isinstance(value, str):
            file = user_code.file_of(value) or value
            if file not in named and (found := digest(file)) is not None:
                named[file] = found
                found_in += _named_in(file, found)
                modules += user_code.local_modules(file).values() if file.endswith(".py") else ()
        elif isinstance(value, Mapping | Sequence):
            found_in += value.values() if isinstance(value, Mapping) else value
    return {str(file): found for file in modules if (found := digest(str(file))) is not None} | named


@lru_cache(maxsize=1024)
def _named_in(file: str, _digest: str) -> list[Any]:
    """Return the files that a user's TOML file names: a machine's MJCF, set-ups of a technology."""
    with suppress(AttributeError, LookupError, TypeError, errors.InputError):
        table = files.read_toml(file) if file.endswith(".toml") else {}
        mjcf = [str(Path(file).parent / table["model"])] if "model" in table else []
        of_passes = [one["generator"] for at in table.get("height", ()) for one in at["pass"]]
        return [*mjcf, *of_passes, *(table.get(part) for part in ("machine", "material", "wire"))]
    return []


def identity(content: Mapping[str, Any]) -> str:
    """Return the id of a run: a digest of everything that decides its result."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:20]


@errors.refuses_wrong_types
def perform(
    work: Callable[[Any], Any], jobs: Sequence[Any], watch: Callable[[int, int], None] | None = None, *,
    engine: "Engine | None" = None, table: RunTable | None = None, ids: Sequence[str] = (),
) -> list[Any]:
    """Run jobs on all cores, and return their answers in order; an error or an interruption ends all of them.

    Parameters
    ----------
    work : callable
        Called with a job; returns its answer, a dict if there is a `table`.
    jobs : sequence
    watch : callable, optional
        Called with the number of jobs done and that of all jobs, first before any job is done.
    engine : Engine, optional
        By default threads. For another one, `work` and the jobs must be picklable.
    table : RunTable, optional
        Jobs that it has are not done again; the others are added. Answers are its rows.
    ids : sequence of str
        Ids of the jobs in the table.
    """
    rows: Mapping[str, Row] = {} if table is None else table.rows
    answers: dict[int, Any] = {number: rows[name] for number, name in enumerate(ids) if name in rows}

    def saved(number: int, answer: Any) -> Any:
        if table is None:
            return answer
        row = {"id": ids[number], **answer}
        table.add(row)
        return row

    def made(numbered: tuple[int, Any]) -> Any:
        # saved in the job's thread, so that runs are also saved if they end after an interruption of the loop below
        return saved(numbered[0], work(numbered[1]))

    left = [numbered for numbered in enumerate(jobs) if numbered[0] not in answers]
    watch = watch or (lambda *_: None)
    watch(len(answers), len(jobs))  # at once, because the first job may take minutes
    found = Threads().done(made, left) if engine is None else _done_elsewhere(engine, work, left, saved)
    for (number, _), answer in found:
        answers[number] = answer
        watch(len(answers), len(jobs))
    return [answers[number] for number in range(len(jobs))]


def _done_elsewhere(
    engine: "Engine", work: Function, jobs: Sequence[tuple[int, Any]], saved: Callable[[int, Any], Any]
) -> Iterator[tuple[tuple[int, Any], Any]]:
    """Yield numbered jobs with their answers; an error of a job is raised here."""
    if isinstance(engine, Processes):
        _refuse_not_importable(work)
    for (number, _, job), answer in engine.done(_attempted, ((number, work, job) for number, job in jobs)):
        if isinstance(answer, LostJob):
            raise errors.EdmsimError(answer.why)
        if isinstance(answer, Exception):
            raise answer
        yield (number, job), saved(number, answer)


def _refuse_not_importable(work: Function) -> None:
    """Refuse a function of a notebook or script, or nested in another, because a new process cannot import it."""
    function = getattr(work, "func", work)  # of a partial
    name = getattr(function, "__qualname__", "")
    if function.__module__ == "__main__" or "<" in name:
        raise errors.InputError(
            f"other processes cannot import {name or work!r}: define it in a module, or use threads, engine=None"
        )


def _attempted(numbered: tuple[int, Function, Any]) -> Any:
    """Return the answer of a job, or the error that it raised."""
    try:
        return numbered[1](numbered[2])
    except Exception as error:
        text = "".join(format_exception(error))
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return errors.EdmsimError(str(error)) if isinstance(error, errors.EdmsimError) else RuntimeError(text)
        if not isinstance(error, errors.EdmsimError):
            error.add_note(text)  # the traceback, which is lost between processes
        return error


LONG_S = 3600.0
"""Machine time of cuts above which processes are faster (ours: processes take some seconds to start, and threads
wait for the GIL)."""


def engine_for(machine_s: float) -> "Engine | None":
    """Return the faster engine for cuts of this much machine time in total: processes, or None for threads."""
    return Processes() if machine_s > LONG_S and processors() > 1 else None


ATTEMPTS = 3  # attempts at a job whose process or computer is lost, before it counts as failed (ours)


class LostJob:
    """The answer to a job whose process or computer was lost at every attempt, with the reason."""

    def __init__(self, why: str) -> None:
        self.why = f"{why}; given up after {ATTEMPTS} attempts"


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Engine(Protocol):
    """Runs the jobs of a sweep.

    An engine takes jobs from the iterator only as it finishes others (back-pressure; threads take all at once), and
    yields answers in the order in which jobs finish. Except in threads, the function must not raise.
    """

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """Yield each job with its answer or `LostJob`; closing the iterator drops the remaining jobs."""
        ...


class Threads:
    """Runs jobs in threads of this process, one per available processor; an error in one ends them all."""

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """See `Engine.done`."""
        with ThreadPoolExecutor(processors()) as pool:
            running = {pool.submit(function, job): job for job in jobs}
            try:
                for ended in as_completed(running):
                    yield running[ended], ended.result()
            finally:
                pool.shutdown(cancel_futures=True)


@errors.methods_refuse_wrong_types
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
        self.count = processors() if count is None else numeric.whole_from("count", count, 1)

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """See `Engine.done`."""
        answers: queue.SimpleQueue[tuple[Any, Any]] = queue.SimpleQueue()
        workers: list[_Worker] = []
        busy = 0
        try:
            for job in jobs:
                idle = next((worker for worker in workers if not worker.busy), None)
                if idle is None:
                    idle = _Worker(function, answers)
                    workers.append(idle)
                idle.give(job)
                busy += 1
                if busy == self.count:
                    yield answers.get()
                    busy -= 1
            for _ in range(busy):
                yield answers.get()
        finally:
            for worker in workers:
                worker.stop()


class _Worker:
    """A process, and a thread that exchanges jobs with it; a process that dies is replaced, and its job restarted."""

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
        """Run a job in the process; it must be picklable."""
        pickled = pickle.dumps(job)
        self.busy = True
        self._jobs.put((job, pickled))

    def stop(self) -> None:
        """End thread and process, even during a job."""
        self._stopped = True
        self._jobs.put(None)
        if (process := self._process) is not None:
            process.kill()
        self._thread.join()

    def _serve(self) -> None:
        while (queued := self._jobs.get()) is not None and not self._stopped:
            job, pickled = queued
            answer = self._answered(pickled)
            self.busy = False
            self._answers.put((job, answer))
        self._end()

    def _answered(self, pickled: bytes) -> Any:
        why = ""
        for _ in range(ATTEMPTS):
            process = self._process = self._process or self._begin()
            if self._stopped:
                break
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                process.stdin.write(pickled)
                process.stdin.flush()
                return pickle.load(process.stdout)
            except (EOFError, OSError, pickle.UnpicklingError):
                self._end()
                why = f"the process that made the run ended with status {process.returncode}"
            except Exception as error:  # the class of the answer cannot be unpickled
                self._end()
                why = f"the answer of the process that made the run cannot be read: {error}"
        return LostJob(why)

    def _begin(self) -> subprocess.Popen[bytes]:
        # a worker can import the same modules as this process; threads of libraries would only compete
        path = os.pathsep.join(place or os.getcwd() for place in sys.path)
        environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(
            [sys.executable, "-c", "from edmsim.runs import serve; serve()", self._name], stdin=subprocess.PIPE,
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


def serve() -> None:
    """Run jobs from standard input until it is closed, which also ends a job in progress: the main program."""
    function = resolve_name(sys.argv[1])
    source = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a user's code prints goes to standard error, and not between the answers
    jobs: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(source, jobs), daemon=True).start()
    while True:
        pickle.dump(function(jobs.get()), answers)
        answers.flush()


def _read(source: BinaryIO, jobs: queue.SimpleQueue[Any]) -> None:
    while True:
        try:
            jobs.put(pickle.load(source))
        except (EOFError, OSError):
            os._exit(0)
        except Exception:  # a job that this process cannot import
            print_exc()
            os._exit(1)


IN_FLIGHT = 2
"""Jobs submitted per processor (ours): one runs, and one waits there until the answer has been transferred."""
LOOK_S = 2.0  # longest time between two checks of the number of processors


@errors.methods_refuse_wrong_types
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
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no usage statistics unless the user enables them
        # avoids Ray's warning that it will not hide GPUs in future; runs use none
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        try:
            import ray
        except ImportError as error:
            raise errors.InputError(f"a cluster needs {error.name}: pip install 'edmsim[cluster]'") from None
        self._ray: Any = ray
        if not ray.is_initialized():
            try:
                host, _, port = address.rpartition(":")
                if port.isdecimal() and "/" not in host:  # because Ray would try for minutes
                    socket.create_connection((host, int(port)), timeout=LOOK_S).close()
                # for a cluster on one computer, Ray would use the address under which other computers know it
                here: dict[str, Any] = {"_node_ip_address": host} if host.startswith("127.") else {}
                ray.init(address=address, log_to_driver=False, logging_level="ERROR", **here)
            except (OSError, ValueError, RuntimeError) as error:
                reason = str(error).split(". ")[0]
                raise errors.InputError(
                    f"there is no Ray cluster at '{address}' ({reason}); start one: ray start"
                ) from None

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
        except self._ray.exceptions.LocalRayletDiedError:  # no job can run any longer, so this one has not failed
            raise errors.EdmsimError(
                "Ray has ended on this computer: start it again, and run the same command"
            ) from None
        except self._ray.exceptions.RayError as error:
            return LostJob(str(error).strip().split("\n")[0] or type(error).__name__)


def engine_of(ray: str | None, processes: int | None) -> Engine:
    """Return where a command makes its runs: in processes of this computer, or on a cluster."""
    if ray is None:
        return Processes(None if processes is None else numeric.whole_from("--processes", processes, 1))
    if processes is not None:
        raise errors.InputError("--processes are those of this computer: leave them out with --ray")
    return Cluster(ray)
