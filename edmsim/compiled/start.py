"""What lets a process with numba start and end sooner: numba makes a hundred thousand objects that stay."""

from __future__ import annotations

import atexit
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader, BytesIO, FileIO, StringIO, TextIOWrapper
from itertools import compress
from types import GeneratorType
from typing import Any


@contextmanager
def garbage_left() -> Iterator[None]:
    """Let the garbage collector wait: it takes a tenth of the time to compile, and finds little."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            if gc.get_freeze_count() == 0:  # otherwise a program keeps objects of its own out of reach
                gc.freeze()  # these two count all that there is as old, which is looked through only now and then
                gc.unfreeze()
            gc.enable()


_NOTHING = object()


@contextmanager
def replaced(owner: Any, **values: Any) -> Iterator[None]:
    """Replace attributes of an object, a class or a module for a while; `unittest.mock` would load asyncio."""
    before = {name: vars(owner).get(name, _NOTHING) for name in values}
    for name, value in values.items():
        setattr(owner, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is _NOTHING:
                delattr(owner, name)
            else:
                setattr(owner, name, value)


@atexit.register
def _end_at_once() -> None:
    """Keep Python from looking through all objects three times as it ends, a quarter of an environment's start.

    Only where no object does anything of use when it goes: no file of a user's stays unwritten.
    """
    alive = gc.get_objects()
    acting = {kind for kind in set(map(type, alive)) if any("__del__" in vars(base) for base in kind.__mro__)}
    if all(map(_goes_idly, compress(alive, map(acting.__contains__, map(type, alive))))):
        gc.freeze()


_IDLE = "llvmlite", "numba", "numpy", "pyparsing"
_NOTHING_TO_WRITE = FileIO, BufferedReader, BytesIO, StringIO


def _goes_idly(thing: Any) -> bool:
    """Whether an object has nothing to do when it goes, or is of a package that only frees memory, or warns."""
    kind = type(thing)
    if issubclass(kind, TextIOWrapper):
        return thing in (sys.__stdin__, sys.__stdout__, sys.__stderr__)  # which Python flushes
    if kind is GeneratorType and thing.gi_frame is None:
        return True  # it has run to its end
    home = thing.gi_frame.f_globals.get("__name__", "") if kind is GeneratorType else kind.__module__
    return kind in _NOTHING_TO_WRITE or home.partition(".")[0] in _IDLE
