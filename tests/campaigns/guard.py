"""What no input may bring about: an end of the interpreter, an error that is none of ours, a hang, a file elsewhere,
something unpickled, another program begun, a socket that others reach."""

import os
import resource
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edmsim.errors import LONGEST_PLACE, LONGEST_REASON, EdmsimError

MOST_CPU_S = 1.0
"""Of the processor, not of the clock: others use the machine as well."""
TIMEOUT_S = 10.0
MOST_BYTES = 1 << 30
"""That an input may add at its greatest to what the process holds."""
LONGEST_MESSAGE = LONGEST_PLACE + LONGEST_REASON + 20
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_MOVES = {
    "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.symlink", "os.link", "os.truncate", "os.chmod",
    "shutil.rmtree", "shutil.move", "shutil.copyfile",
}  # fmt: skip
_COMPILERS = ("edmsim.compiled.jit", "edmsim.compiled.specialised")
_PROGRAMS = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.spawn"}
_WATCHED = {"open", "pickle.find_class", "socket.bind", "socket.connect", *_MOVES, *_PROGRAMS}
_active: list[Path] = []
_events: list[str] = []


class Hang(BaseException):
    """An input kept the processor for `TIMEOUT_S`; derived so that no reader catches it."""


def _audit(event: str, args: tuple[Any, ...]) -> None:
    if not _active or event not in _WATCHED or _is_the_compilers():
        return
    if (event == "open" and isinstance(args[2], int) and args[2] & _WRITES) or event in _MOVES:
        _within(event, args[0])
    elif event == "pickle.find_class":
        _events.append(f"unpickled {args[0]}.{args[1]}")
    elif event in _PROGRAMS:
        _events.append(f"began a program: {event} {args[0]!r}")
    elif event in ("socket.bind", "socket.connect"):
        where = args[1][0] if isinstance(args[1], tuple) else args[1]
        if where not in ("127.0.0.1", "::1", "localhost"):
            _events.append(f"{event} {where!r}")


def _is_the_compilers() -> bool:
    """Whether code is being compiled, by a process of its own too, or its cache read or written.

    The cache stands in a folder of the user's own; on an empty one the first input that needs the pulse loop waits.
    Python writes the bytecode of what an input imports first, where its library is the user's own.
    """
    frame = sys._getframe(2)
    if frame.f_globals.get("__name__") == "importlib._bootstrap_external":
        return True
    while frame is not None:
        name = frame.f_globals.get("__name__", "")
        if name.startswith("numba.core.") or name in _COMPILERS:
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


def _within(event: str, place: Any) -> None:
    if isinstance(place, int) or place in ("/dev/null", b"/dev/null"):
        return
    found = Path(os.path.realpath(os.fsdecode(place)))
    if not found.is_relative_to(_active[-1]):
        _events.append(f"{event} outside its folder: {found}")


sys.addaudithook(_audit)


@contextmanager
def watched(folder: Path) -> Iterator[list[str]]:
    """Gather what should not be done, while files may be written to `folder` only."""
    _events.clear()
    _active.append(Path(os.path.realpath(folder)))
    try:
        yield _events
    finally:
        _active.pop()


def _give_up(*_: object) -> None:
    raise Hang


def judged(read: Any, data: bytes, folder: Path) -> tuple[str, list[str]]:
    """Let a reader read an input.

    Returns
    -------
    str
        ``"taken"`` or ``"refused"``.
    list of str
        What was wrong; empty as it should be.
    """
    wrong: list[str] = []
    what = "taken"
    began, before = time.process_time(), _held_bytes()
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.signal(signal.SIGVTALRM, _give_up)
    with watched(folder) as events:
        try:
            signal.setitimer(signal.ITIMER_VIRTUAL, TIMEOUT_S)
            read(data, folder)
        except EdmsimError as error:
            what = "refused"
            wrong += _message(str(error))
        except Hang:
            wrong.append(f"hangs: given up after {TIMEOUT_S:g} s")
        except BaseException as error:
            what = "refused"
            wrong.append(_where(error))
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        wrong += events
    took = time.process_time() - began
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if took > MOST_CPU_S:
        wrong.append(f"slow: {took:.1f} s")
    if held > most and held * 1024 - before > MOST_BYTES:
        wrong.append(f"memory: {held / 1024:.0f} MB")
    return what, wrong


def _held_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _message(text: str) -> list[str]:
    if len(text.splitlines()) != 1:
        return [f"message of {len(text.splitlines())} lines"]
    return ["long message"] if len(text) > LONGEST_MESSAGE else []


def _where(error: BaseException) -> str:
    trace, place = error.__traceback__, ""
    while trace is not None:
        name = trace.tb_frame.f_code.co_filename
        if "edmsim" in trace.tb_frame.f_globals.get("__name__", ""):
            place = f"{Path(name).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return f"{type(error).__name__} at {place}"
