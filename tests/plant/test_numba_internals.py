"""What edmsim uses of numba beyond its documented interface, by name: a release that changes it fails here."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import numba
import pytest
from numba import types
from numba.core import caching, cgutils, codegen, datamodel, dispatcher
from numba.core.typing import templates
from numba.np import arrayobj

import edmsim

USED = [
    (caching, "IndexDataCacheFile"), (caching.IndexDataCacheFile, "_data_name"),
    (caching.IndexDataCacheFile, "_data_path"), (caching.IndexDataCacheFile, "_load_data"),
    (caching.IndexDataCacheFile, "_load_index"), (caching.IndexDataCacheFile, "_open_for_write"),
    (codegen.CPUCodeLibrary, "finalize"), (codegen.CPUCodeLibrary, "_raise_if_finalized"),
    (codegen.CPUCodeLibrary, "_optimize_functions"), (codegen.JITCodeLibrary, "get_pointer_to_function"),
    (codegen.JITCPUCodegen, "set_env"), (codegen.JITCPUCodegen, "_create_empty_module"),
    (dispatcher._FunctionCompiler, "compile"), (dispatcher._DispatcherBase, "get_call_template"),
    (cgutils, "unpack_tuple"), (cgutils, "pointer_add"), (cgutils, "create_struct_proxy"),
    (cgutils, "get_or_insert_function"), (datamodel, "PrimitiveModel"), (datamodel, "StructModel"),
    (templates, "AttributeTemplate"), (templates.AttributeTemplate, "generic_resolve"),
    (arrayobj, "populate_array"), (types, "unliteral"),
]  # fmt: skip


@pytest.mark.parametrize(("where", "name"), USED, ids=[name for _, name in USED])
def test_numba_has_what_is_used_of_its_internals(where: Any, name: str) -> None:
    assert hasattr(where, name)


def test_a_function_keeps_its_module_and_what_it_calls_apart() -> None:
    """The parts of which `numba_internals.whole_program` makes one module."""

    @numba.njit
    def twice(x: int) -> int:
        return 2 * x

    assert twice(2) == 4
    result = next(iter(twice.overloads.values()))
    assert "define" in str(result.library._final_module)
    assert isinstance(result.library._linking_libraries, list)
    assert result.fndesc.llvm_func_name in str(result.library._final_module)


def test_no_other_file_uses_them() -> None:
    """`numba.core`, `numba.np` and names with an underscore are numba's own."""
    private = re.compile(r"(?:from|import) numba\.(?:core|np|misc|typed)|numba\._|\._(?:cache|compiler)\b")
    package = Path(inspect.getfile(edmsim)).parent
    found = {
        file.relative_to(package).as_posix()
        for folder in (package, package.parent / "controllers", package.parent / "envs")
        for file in folder.rglob("*.py") if private.search(file.read_text(encoding="utf-8"))
    }
    assert found == {"compiled/numba_internals.py"}
