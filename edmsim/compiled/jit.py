"""Decorators that compile functions with numba, without the GIL, and cache the code."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar, cast

import numba

from edmsim.compiled.numba_internals import INLINED, UNWRAPPED, with_parts

_P = ParamSpec("_P")
_R = TypeVar("_R")
# NaN and infinity keep their meaning: the loop tests for them. The rest lets sums be vectorised.
FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
_OPTIONS: dict[str, Any] = {
    "nogil": True, "fastmath": FAST, "error_model": "numpy", "no_cfunc_wrapper": True, **INLINED,
}
_CALLED: dict[str, Any] = {"forceinline": False}
apart: set[str] = set()  # names of the functions that `compiled_apart` has made, with their modules'
_whole_program: dict[str, Any] = {}
_count = 0


@contextmanager
def whole_program_only() -> Iterator[Callable[[], int]]:
    """Decorate functions that are only translated as parts of a whole program; says how many there were."""
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
    """Compile a function: no Python objects, no GIL, machine code kept between runs."""
    return cast("Callable[_P, _R]", _made(function, {}))


def compiled_apart(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile a function that is called, not inlined: what few pulses need."""
    # it leaves the loop around it as it is, and LLVM takes the less time the smaller its functions are
    apart.add(f"{function.__module__}.{function.__qualname__}")
    return cast("Callable[_P, _R]", _made(function, _CALLED))


def exactly_compiled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Compile what runs a few times per window: every operation is rounded as it is written."""
    # functions are called and not inlined, which takes a fraction of the time to compile
    return cast("Callable[_P, _R]", _made(function, {**_CALLED, "fastmath": False}))
