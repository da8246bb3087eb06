"""State that is declared once is saved and loaded: through JSON, or as arrays."""

import io
import json
from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.snapshots import ArraySnapshots, Snapshots


class Cause(IntEnum):
    NONE = 0
    LATE = 3


class Step(NamedTuple):
    time_ns: int
    axis: int


@dataclass
class Wall:
    mean_um: float
    slices_um: tuple[float, ...]


@dataclass
class Record:
    number: int
    wall: Wall | None = None


class Part(Snapshots):
    STATE = ("count",)

    def __init__(self, count=0):
        self.count = count


@dataclass
class Law(Snapshots):
    """Has an argument, and fields of every kind that are invalid."""

    gain: float = 1.0

    records: list[Record] = field(default_factory=list, init=False)
    aim: Step | None = field(default=None, init=False)
    steps: list[Step] = field(default_factory=list, init=False)
    by_name: dict[str, float] = field(default_factory=dict, init=False)
    part: Part = field(default_factory=Part, init=False)
    memory: bytearray = field(default_factory=lambda: bytearray(4), init=False)
    array: Any = field(default_factory=lambda: np.zeros((2, 2), [("a", "f4"), ("b", "i8")]), init=False)

    def __post_init__(self):
        self.from_set_up = 0.0


class Machine(Snapshots):
    STATE = ("cause", "_keys", "scans", "open", "pair", "text", "part")

    def __init__(self):
        self.cause, self._keys, self.scans = Cause.NONE, deque[int](), dict[int, int]()
        self.open = set()
        self.pair = (Wall(0.0, ()), Wall(0.0, ()))
        self.text = None
        self.part = None


floats = st.floats(allow_nan=False)
walls = st.builds(Wall, floats, st.lists(floats, max_size=3).map(tuple))
steps = st.builds(Step, st.integers(), st.integers(0, 3))


def through_json(thing):
    return json.loads(json.dumps(thing.snapshot()))


@pytest.mark.slow
@given(
    st.lists(st.builds(Record, st.integers(), st.none() | walls), max_size=3), st.none() | steps, st.lists(steps),
    st.dictionaries(st.text(), floats), st.integers(), st.binary(min_size=4, max_size=4),
    st.floats(width=32, allow_nan=False),
)  # fmt: skip
def test_the_fields_that_are_no_arguments_go_through_json(records, aim, made, by_name, count, memory, number):
    law, again = Law(gain=2.0), Law(gain=3.0)
    law.records, law.aim, law.steps, law.by_name, law.part.count = records, aim, made, by_name, count
    law.memory[:], law.from_set_up = memory, 1.0
    law.array["a"][0, 1], law.array["b"][1, 0] = number, count % 2**60
    part, ram = again.part, again.memory
    again.restore(through_json(law))
    assert (again.gain, again.from_set_up) == (3.0, 0.0)
    assert again.part is part
    assert again.memory is ram
    assert again.array.tobytes() == law.array.tobytes()
    again.array, again.gain, again.part = law.array, law.gain, law.part
    assert repr(again) == repr(law)


@given(st.sampled_from(Cause), st.lists(st.integers()), st.dictionaries(st.integers(), st.integers()),
       st.sets(st.sampled_from(["x", "y", "z"])), st.tuples(walls, walls), st.none() | st.text())  # fmt: skip
def test_what_a_class_names_goes_through_json(cause, keys, scans, opened, pair, text):
    machine, again = Machine(), Machine()
    machine.cause, machine._keys, machine.scans, machine.open, machine.pair, machine.text = (
        cause, deque(keys), scans, opened, pair, text
    )  # fmt: skip
    again.text = "before"
    again.restore(through_json(machine))
    assert vars(again) == vars(machine)
    assert isinstance(again.cause, Cause)


def test_a_state_that_lacks_something_is_refused():
    state = Part(3).snapshot()
    del state["count"]
    with pytest.raises(KeyError, match="count"):
        Part().restore(state)


class Store(ArraySnapshots):
    STATE = ("_observed", "feed_um_s", "lengths", "_last", "rows", "inner")

    def __init__(self, size, inner=None):
        self._observed, self.feed_um_s, self._used = 0, 0.0, 0
        self.lengths = []
        self._last, self._room = np.zeros(size), np.zeros(8)
        self.inner = {1: inner} if inner else {}

    @property
    def rows(self):
        return self._room[: self._used]

    @rows.setter
    def rows(self, rows):
        self._used = len(rows)
        self._room[: self._used] = rows


def test_stores_go_through_a_file_of_arrays():
    store, again = Store(2, Store(3)), Store(2, Store(3))
    for number, each in enumerate((store, store.inner[1])):
        each._observed, each.feed_um_s, each.lengths, each._used = 5 + number, -0.1, [1, 2][number:], 3
        each._last[:], each._room[:3] = 7.0, 4.0 + number
    file, last = io.BytesIO(), again._last
    np.savez(file, **store.snapshot())
    file.seek(0)
    again.restore(dict(np.load(file)))
    for one, other in ((again, store), (again.inner[1], store.inner[1])):
        assert (one._observed, one.feed_um_s, one.lengths, one._used) == (
            other._observed, other.feed_um_s, other.lengths, other._used
        )  # fmt: skip
        np.testing.assert_array_equal(one._last, other._last)
        np.testing.assert_array_equal(one.rows, other.rows)
    assert again._last is last
    assert type(again._observed) is int


def test_an_array_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"a snapshot's last, \(2,\) of type float64, does not fit \(3,\)"):
        Store(3).restore(Store(2).snapshot())
