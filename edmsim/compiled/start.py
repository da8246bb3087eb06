"""A faster start of a process with numba, which makes a hundred thousand objects that stay."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
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
