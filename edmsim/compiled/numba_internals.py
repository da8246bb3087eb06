"""Everything that edmsim uses of numba beyond its documented interface.

`tests/plant/test_numba_internals.py` names each of them, so that a release of numba that changes one says so there.
"""

from __future__ import annotations

import io
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

import llvmlite.binding as llvm
import numba
from numba import types as untyped_types
from numba.core import caching, codegen
from numba.core import cgutils as untyped_cgutils
from numba.core import datamodel as untyped_datamodel
from numba.core import dispatcher as untyped_dispatcher
from numba.core.typing.templates import AttributeTemplate as UntypedTemplate
from numba.np.arrayobj import populate_array as untyped_populate_array

from edmsim.compiled import cache

cgutils: Any = untyped_cgutils
datamodel: Any = untyped_datamodel
dispatcher: Any = untyped_dispatcher
AttributeTemplate: Any = UntypedTemplate
populate_array: Any = untyped_populate_array
types: Any = untyped_types

INLINED: dict[str, Any] = {"forceinline": True, "_nrt": False}
"""Options of a function that is inlined where it is called. Arrays are not reference-counted in it: their owner
outlives the call, and the atomic counting took a third of the pulse loop's time. So nothing in it may allocate."""
UNWRAPPED: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of a function that only compiled code calls: each wrapper is compiled with a copy of its function."""


class _SignedFiles(caching.IndexDataCacheFile):
    """Files of a function's machine code, each with its digest at its end; a damaged one is as if there were none."""

    def save(self, key: Any, data: Any) -> None:
        with suppress(OSError):  # what cannot be kept, on a full disk say, is compiled again the next time
            super().save(key, data)  # type: ignore[no-untyped-call]

    def _data_name(self, _: int) -> Any:
        # numbered in turn, two processes that compile at once would take the same name for different code
        return super()._data_name(secrets.randbits(48))  # type: ignore[no-untyped-call]

    def _load_index(self) -> Any:
        whole = cache.read_signed(Path(self._index_path)) is not None
        return super()._load_index() if whole else {}  # type: ignore[no-untyped-call]

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)  # type: ignore[no-untyped-call]
        if cache.read_signed(Path(path)) is None:
            raise FileNotFoundError(path)
        return super()._load_data(name)  # type: ignore[no-untyped-call]

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(cache.signed(content.getvalue()))


def in_cache(make: Callable[[Any], Any], function: Callable[..., Any]) -> Any:
    """Apply one of numba's decorators to a function, its machine code kept in the folder of these sources."""
    config: Any = numba.config
    with (
        patch.object(config, "CACHE_DIR", str(cache.folder)),
        patch.object(caching, "IndexDataCacheFile", _SignedFiles),
    ):
        return make(function)


@contextmanager
def _without_machine_code(compiled: Callable[[str], None]) -> Iterator[None]:
    """Let numba translate functions to LLVM's language and no further, and report each one by its name.

    As it stands numba links each function with all it calls, optimises that and makes machine code of it, again for
    each function that calls it.
    """

    def finalize(self: Any) -> None:
        self._raise_if_finalized()
        self._finalized = True

    translate = dispatcher._FunctionCompiler.compile

    def translate_and_report(self: Any, *arguments: Any) -> Any:
        done = translate(self, *arguments)
        compiled(f"{self.py_func.__module__}.{self.py_func.__qualname__}")
        return done

    resolve = dispatcher._DispatcherBase.get_call_template

    def resolve_by_type(self: Any, arguments: Any, named: Any) -> Any:
        # numba translates a function once more for each constant that it is called with
        plain = tuple(types.unliteral(argument) for argument in arguments)
        named = {name: types.unliteral(kind) for name, kind in named.items()}
        return resolve(self, plain, named)

    with (
        patch.object(codegen.CPUCodeLibrary, "finalize", finalize),
        patch.object(codegen.CPUCodeLibrary, "_optimize_functions", lambda *_: None),
        patch.object(codegen.JITCodeLibrary, "get_pointer_to_function", lambda *_: 0),
        patch.object(codegen.JITCPUCodegen, "set_env", lambda *_: None),
        patch.object(dispatcher._FunctionCompiler, "compile", translate_and_report),
        patch.object(dispatcher._DispatcherBase, "get_call_template", resolve_by_type),
    ):
        yield


def whole_program(
    function: Any, signature: tuple[Any, ...], compiled: Callable[[str], None]
) -> tuple[llvm.ModuleRef, str]:
    """Translate a function and all it calls into one module of LLVM's language.

    The functions must not have been compiled before in this process.

    Parameters
    ----------
    function : dispatcher
        Made by ``numba.njit``.
    signature : tuple of numba types
    compiled : callable
        Called with the name of every function that is translated.

    Returns
    -------
    module : llvmlite.binding.ModuleRef
    name : str
        That of the function in it: ``i32 name(return value's place, exception's place, *arguments)``.
    """
    with _without_machine_code(compiled):
        function.compile(signature)
    result = function.overloads[signature]
    module = llvm.parse_assembly(str(result.library._codegen._create_empty_module("edmsim")))
    waiting, linked = [result.library], []
    while waiting:
        library = waiting.pop()
        if library not in linked:
            linked.append(library)
            module.link_in(library._final_module, preserve=True)
            waiting += library._linking_libraries
    return module, result.fndesc.llvm_func_name
