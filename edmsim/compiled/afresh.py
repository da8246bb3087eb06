"""Machine code whose bits do not depend on what a process compiled before.

The liberties of `jit.FAST` let the compiler order sums, and the order it chooses depends on what it has compiled so
far in the same process. Code that decides the bits of a cut is therefore compiled in a process of its own, which does
nothing else, and loaded from the cache.
"""

from __future__ import annotations

import gc
import importlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from numba import types

from edmsim.compiled import jit

try:
    import fcntl
except ImportError:  # where there is no flock, two processes may compile the same
    fcntl = None  # type: ignore[assignment]

_THREADS = threading.Lock()
_PROGRAM = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = {path!r}
from edmsim.compiled.afresh import compile_alone
compile_alone({folder!r}, {module!r}, {name!r}, {arguments!r})
"""
"""An interrupt is for whoever waits for this, and stops it."""

PROGRESS = "EDMSIM_PROGRESS"
"""Variable of the environment: with 0 a notebook shows neither how far a cut is nor that code is compiled."""
_NOTICE = "edmsim compiles its pulse loop for this processor: about a minute, once at each resolution"


def made_afresh(make: Callable[..., Any], *arguments: int) -> Any:
    """Return ``make(*arguments)``, a compiled function of whole numbers, its machine code in the cache.

    What is not there is compiled by a process of its own, which takes a minute or so. Where no process can be
    started or nothing can be kept, this one compiles at the first call, and the last bits may be others.

    Parameters
    ----------
    make : callable
        A function of a module that returns a function made with `jit.compiled`.
    *arguments : int or bool
        What it is called with.
    """
    function = make(*arguments)
    if jit.is_kept(function, _signature(function)):
        return function
    with _waiting(f"{make.__name__}-{'-'.join(map(str, arguments))}"):
        if not jit.is_kept(function, _signature(function)):
            _compile_elsewhere(make, arguments)
    return function


@contextmanager
def _waiting(name: str) -> Iterator[None]:
    """Let one thread of one process compile something; whoever waited finds it made."""
    with _THREADS, ExitStack() as open_files:
        with suppress(OSError):
            file = open_files.enter_context((jit.folder() / f"{name}.lock").open("w"))
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _compile_elsewhere(make: Callable[..., Any], arguments: tuple[int, ...]) -> None:
    program = _PROGRAM.format(
        path=sys.path, folder=str(jit.folder()), module=make.__module__, name=make.__name__, arguments=arguments
    )
    if sys.stderr.isatty() or ("ipykernel" in sys.modules and os.environ.get(PROGRESS) != "0"):
        print(_NOTICE, file=sys.stderr)
    # strings' hashes decide the order of the compiler's own sets
    environment = {**os.environ, "PYTHONHASHSEED": "0"}
    with suppress(OSError):
        subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=False)


def compile_alone(folder: str, module: str, name: str, arguments: tuple[int, ...]) -> None:
    """Compile one function with all it calls, and keep only it; for a process that does nothing else."""
    gc.disable()  # a tenth of the time, for what a process that soon ends need not give back
    jit.use_folder(Path(folder))
    with jit.only_called_by_compiled_code():
        make = getattr(importlib.import_module(module), name)
    function = make(*arguments)
    jit.keep_alone(function)
    function.compile(_signature(function))


def _signature(function: Any) -> tuple[Any, ...]:
    return (types.int64,) * int(function.py_func.__code__.co_argcount)
