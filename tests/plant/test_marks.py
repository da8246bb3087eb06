"""Marks in a compiled program: while it runs, a number shows which of its parts is running."""

import ctypes
import importlib
import threading

import llvmlite.binding as llvm
import numpy as np
import pytest

from edmsim.compiled import cache
from edmsim.compiled.specialised import PART, _target_machine, marked, with_marks

PROGRAM = """
define i64 @_ZN4room5innerB2v1(i64 %x) {
entry:
  %seen = load volatile i64, ptr @edmsim_part
  ret i64 %seen
}
define i64 @_ZN4room5outerB2v2(i64 %x) {
entry:
  %inner = call i64 @_ZN4room5innerB2v1(i64 %x)
  %after = load volatile i64, ptr @edmsim_part
  %tens = mul i64 %inner, 10
  %both = add i64 %tens, %after
  %odd = trunc i64 %x to i1
  br i1 %odd, label %one, label %other
one:
  ret i64 %both
other:
  ret i64 0
}
define i64 @_ZN4room10outer_partB2v3(i64 %x) {
entry:
  %seen = load volatile i64, ptr @edmsim_part
  ret i64 %seen
}
"""
"""Return values: `outer` returns ten times the part during `inner`, plus its own part."""


def engine_of(program):
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(program), _target_machine())
    engine.finalize_object()
    return engine


def test_a_function_counts_for_its_own_part_and_gives_back_that_around_it():
    engine = engine_of(with_marks(PROGRAM, [["room.outer"], ["room.inner"]]))
    part = ctypes.c_int64.from_address(engine.get_global_value_address(PART))
    call = {
        name: ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(engine.get_function_address(name))
        for name in ("_ZN4room5outerB2v2", "_ZN4room10outer_partB2v3")
    }
    assert call["_ZN4room5outerB2v2"](1) == 21
    assert part.value == 0
    part.value = 7
    assert call["_ZN4room5outerB2v2"](0) == 0  # the other return
    assert call["_ZN4room10outer_partB2v3"](0) == 7  # another function, whose name has the same beginning
    assert part.value == 7


def test_a_function_that_the_program_does_not_have_is_named():
    with pytest.raises(LookupError, match="none of the functions _ZN4room5otherB"):
        with_marks(PROGRAM, [["room.inner", "room.other"]])


LOOP = """\
from edmsim.compiled.jit import compiled
from edmsim.plant.kernel.memory import _rows

@compiled
def add(x, turn):
    return (x * 31 + turn) % 1_000_003

def loop(place, turns):
    rows = _rows(place, (1, 1))
    for turn in range(turns):
        rows[0, 0] = (add(rows[0, 0], turn) * 17 + 5) % 999_983
"""


@pytest.mark.slow
def test_marks_of_a_compiled_program_are_observed_while_it_runs(tmp_path, monkeypatch):
    (tmp_path / "loops.py").write_text(LOOP)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(cache, "folder", tmp_path)
    loops, turns, x = importlib.import_module("loops"), 200_000, 0
    run, part = marked(loops.loop, turns, parts=(("loops.add",), ("loops.loop",)))
    total, observed, over = np.array([[0]]), set(), threading.Event()

    def look():
        while not over.is_set():
            observed.add(part())
            over.wait(1e-4)

    thread = threading.Thread(target=look)
    thread.start()
    for _ in range(100):  # repeated, because the other thread may wait on a busy machine
        total[:] = 0
        run(total.ctypes.data)
        if {1, 2} <= observed:
            break
    over.set()
    thread.join()
    for turn in range(turns):
        x = ((x * 31 + turn) % 1_000_003 * 17 + 5) % 999_983
    assert (total[0, 0], observed - {0}, part()) == (x, {1, 2}, 0)
    (bitcode,) = tmp_path.rglob("loop-*.bc")
    assert bitcode.name.count("-") == 2  # separate from that of the program without marks
