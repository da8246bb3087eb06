"""Decorators that compile functions with numba. The code releases the GIL and is cached."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar, cast

import numba

from edmsim.compiled.numba_internals import INLINED, UNWRAPPED, with_parts

_P = ParamSpec("_P")
_R = TypeVar("_R")
# without nnan and ninf, because the loop tests for NaN and infinity; the others allow vectorised sums
FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
_OPTIONS: dict[str, Any] = {
    "nogil": True, "fastmath": FAST, "error_model": "numpy", "no_cfunc_wrapper": True, **INLINED,
}
_CALLED: dict[str, Any] = {"forceinline": False}
apart: set[str] = set()  # qualified names of the functions of `compiled_apart`
_whole_program: dict[str, Any] = {}
_count = 0


@contextmanager
def whole_program_only() -> Iterator[Callable[[], int]]:
    """Decorate functions that are only translated as parts of a whole program; yields a function that counts them."""
    _whole_program.update(UNWRAPPED)
    before = _count
    yield lambda: _count - before
    _whole_program.clear()


def _made(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    global _count
    _count += 1
    made = numba.njit(**{**_OPTIONS, **options, **_whole_program})(function)
    return made if _whole_program else with_parts(made)


def compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function that uses no Python objects; its machine code is cached."""
    return cast("Callable[_P, _R]", _made(function, {}))


def compiled_apart(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function that is called and not inlined, because few pulses need it."""
    # inlined, it would slow down the loop around it; and LLVM compiles small functions faster
    apart.add(f"{function.__module__}.{function.__qualname__}")
    return cast("Callable[_P, _R]", _made(function, _CALLED))


def exactly_compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function that runs a few times per window, without fastmath."""
    # they are called and not inlined, because that compiles several times faster
    return cast("Callable[_P, _R]", _made(function, {**_CALLED, "fastmath": False}))
