"""What edmsim uses of numba beyond its documented interface, by name: a release that changes it fails here."""

import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numba
import pytest
from numba import types
from numba.core import (
    caching,
    callconv,
    cgutils,
    codegen,
    compiler,
    compiler_lock,
    datamodel,
    dispatcher,
    postproc,
    registry,
    sigutils,
    targetconfig,
    transforms,
)  # fmt: skip
from numba.core.annotations import type_annotations
from numba.core.typing import templates
from numba.np import arrayobj, linalg

import edmsim
from edmsim.compiled import cache
from edmsim.compiled.jit import compiled, exactly_compiled
from edmsim.compiled.numba_internals import address_of, call_returning

USED = [
    (caching, "IndexDataCacheFile"), (caching.IndexDataCacheFile, "_data_name"),
    (caching.IndexDataCacheFile, "_data_path"), (caching.IndexDataCacheFile, "_load_data"),
    (caching.IndexDataCacheFile, "_load_index"), (caching.IndexDataCacheFile, "_open_for_write"),
    (codegen.CPUCodeLibrary, "finalize"), (codegen.CPUCodeLibrary, "_raise_if_finalized"),
    (codegen.CPUCodeLibrary, "_optimize_functions"), (codegen.CPUCodeLibrary, "add_linking_library"),
    (codegen.CPUCodeLibrary, "_ensure_finalized"), (codegen.CPUCodeLibrary, "_optimize_final_module"),
    (codegen.JITCPUCodegen, "_pass_builder"), (callconv.CPUCallConv, "call_function"),
    (callconv.CPUCallConv, "get_function_type"), (callconv.CPUCallConv, "return_status_propagate"),
    (cgutils, "if_unlikely"), (codegen.JITCodeLibrary, "get_pointer_to_function"),
    (codegen.JITCPUCodegen, "set_env"), (codegen.JITCPUCodegen, "_create_empty_module"),
    (codegen.JITCodeLibrary, "enable_object_caching"), (compiler, "Compiler"),
    (registry.CPUDispatcher, "compile"), (registry.CPUDispatcher, "_insert"), (caching, "NullCache"),
    (sigutils, "normalize_signature"), (compiler_lock, "global_compiler_lock"),
    (dispatcher._FunctionCompiler, "compile"), (dispatcher._DispatcherBase, "get_call_template"),
    (cgutils, "unpack_tuple"), (cgutils, "pointer_add"), (cgutils, "create_struct_proxy"),
    (cgutils, "get_or_insert_function"), (datamodel, "PrimitiveModel"), (datamodel, "StructModel"),
    (templates, "AttributeTemplate"), (templates.AttributeTemplate, "generic_resolve"),
    (arrayobj, "populate_array"), (arrayobj, "fix_integer_index"), (types, "unliteral"),
    (types.Function, "get_call_type"),
    (linalg, "ensure_blas"), (compiler.Flags, "no_cpython_wrapper"), (targetconfig.TargetConfig, "values"),
    (targetconfig.TargetConfig, "options"), (postproc.PostProcessor, "run"), (postproc, "VariableLifetime"),
    (transforms, "canonicalize_cfg"), (type_annotations, "TypeAnnotation"),
    (registry.CPUDispatcher, "enable_caching"),
]  # fmt: skip


@pytest.mark.parametrize(("where", "name"), USED, ids=[name for _, name in USED])
def test_numba_has_what_is_used_of_its_internals(where, name):
    assert hasattr(where, name)


def test_a_function_keeps_its_module_and_what_it_calls_apart():
    """The parts of which `numba_internals.whole_program` makes one module."""

    @numba.njit
    def twice(x):
        return 2 * x

    assert twice(2) == 4
    result = next(iter(twice.overloads.values()))
    assert "define" in str(result.library._final_module)
    assert isinstance(result.library._linking_libraries, list)
    assert result.fndesc.llvm_func_name in str(result.library._final_module)


def _thirds(x):
    if x < 0:
        raise ValueError("below nought")
    return x / 3


def test_a_part_of_compiled_code_gets_machine_code_when_python_calls_it(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)  # nothing is kept there of a run before
    part = exactly_compiled(_thirds)

    @exactly_compiled
    def whole(x):
        return part(x) + 1.0

    assert whole(1.0) == 1.0 / 3 + 1.0
    assert cast(Any, part).translated
    with pytest.raises(ValueError, match="below nought"):
        whole(-1.0)
    assert part(2.0) == 2.0 / 3
    assert not cast(Any, part).translated
    with pytest.raises(ValueError, match="below nought"):
        part(-1.0)
    assert whole(2.0) == 2.0 / 3 + 1.0


def test_python_calls_what_a_part_calls_and_is_compiled_with_liberties(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)
    third = compiled(_thirds)

    @exactly_compiled
    def part(x):
        return third(x)

    @exactly_compiled
    def whole(x):
        return part(x) + 1.0

    assert whole(3.0) == pytest.approx(2.0)
    assert third(6.0) == pytest.approx(2.0)
    again = compiled(_thirds)  # as another process finds it
    assert again(9.0) == pytest.approx(3.0)
    assert sum(again.stats.cache_hits.values()) == 1


def test_a_part_is_linked_after_all_that_call_it(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)

    @compiled
    def inlined(x):  # numba's own `int` is inlined as well from now on
        return int(x)

    @exactly_compiled
    def first(x):
        return int(x) + 1

    @exactly_compiled
    def with_machine_code(x):
        return first(x) + 1

    @exactly_compiled
    def second(x):
        return int(x) + 2

    @exactly_compiled
    def whole(x):
        return with_machine_code(x) + first(x) + second(x)

    assert inlined(1) == 1
    assert with_machine_code(1) == 3  # it holds `first`, whose own parts nothing calls any more
    assert whole(1) == 8


def test_compiled_code_calls_a_function_at_its_address(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)
    part, third = exactly_compiled(_thirds), call_returning(types.float64)

    @exactly_compiled
    def whole(address, x):
        return third(address, (x,)) + 1.0

    place = address_of(part, types.float64)
    assert whole(place, 2.0) == 2.0 / 3 + 1.0
    assert "_thirds" not in "".join(cast(Any, whole).inspect_llvm().values())
    with pytest.raises(ValueError, match="below nought"):
        whole(place, -1.0)


def test_a_part_is_translated_once_for_all_the_constants_that_it_is_called_with(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)

    @exactly_compiled
    def part(x):
        return x // 3

    @exactly_compiled
    def whole(x):
        return part(7) + part(x) + part(2)

    assert whole(9) == 2 + 3 + 0
    assert cast(Any, part).translated == {(types.int64,)}


def test_no_other_file_uses_them():
    """`numba.core`, `numba.np` and names with an underscore are numba's own."""
    private = re.compile(r"(?:from|import) numba\.(?:core|np|misc|typed)|numba\._|\._(?:cache|compiler)\b")
    package = Path(inspect.getfile(edmsim)).parent
    found = {
        file.relative_to(package).as_posix()
        for folder in (package, package.parent / "controllers", package.parent / "envs")
        for file in folder.rglob("*.py") if private.search(file.read_text(encoding="utf-8"))
    }
    assert found == {"compiled/numba_internals.py"}


def test_a_process_keeps_the_objects_that_it_froze_itself():
    """`gc.unfreeze` would bring them back to the collector."""
    code = "from edmsim.compiled.start import garbage_left; import gc; gc.freeze()\nwith garbage_left(): pass\n"
    code += "print(gc.get_freeze_count() > 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"]
