"""Uses of numba beyond its documented interface: with a release that changes it, these tests fail."""

import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest
from numba import types

import edmsim
from edmsim.compiled import cache
from edmsim.compiled.jit import compiled, exactly_compiled
from edmsim.compiled.numba_internals import address_of, call_returning


def _thirds(x):
    if x < 0:
        raise ValueError("below zero")
    return x / 3


def test_a_part_of_compiled_code_gets_machine_code_when_python_calls_it(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)  # an empty cache
    part = exactly_compiled(_thirds)

    @exactly_compiled
    def whole(x):
        return part(x) + 1.0

    assert whole(1.0) == 1.0 / 3 + 1.0
    assert cast(Any, part).translated
    with pytest.raises(ValueError, match="below zero"):
        whole(-1.0)
    assert part(2.0) == 2.0 / 3
    assert not cast(Any, part).translated
    with pytest.raises(ValueError, match="below zero"):
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
    again = compiled(_thirds)  # as in another process
    assert again(9.0) == pytest.approx(3.0)
    assert sum(again.stats.cache_hits.values()) == 1


def test_a_part_is_linked_after_all_that_call_it(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)

    @compiled
    def inlined(x):  # numba's own `int` is then inlined, too
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
    assert with_machine_code(1) == 3  # it includes `first`, whose own parts are not called any more
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
    with pytest.raises(ValueError, match="below zero"):
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
    """`gc.unfreeze` would return them to the collector."""
    code = "from edmsim.compiled.numba_internals import without_garbage_collection; import gc; gc.freeze()\n"
    code += "with without_garbage_collection(): pass\nprint(gc.get_freeze_count() > 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"]
