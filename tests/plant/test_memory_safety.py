"""No constant and no snapshot makes compiled code write outside its arrays."""

from collections.abc import Callable
from types import GenericAlias
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from pydantic import ValidationError

from edmsim import Machine, Plant
from edmsim.controllers import axis
from edmsim.errors import InputError
from edmsim.machine import components
from edmsim.machine.components import Component
from edmsim.machine.ranges import with_values
from edmsim.plant.kernel.memory import Memory
from edmsim.plant.kernel.state import Arrays, Stored, allocate, fields_of, sizes_of
from edmsim.plant.window import PlantError, WireBrokenError

COMPONENTS = [kind for kind in vars(components).values() if isinstance(kind, type) and issubclass(kind, Component)]
CONSTANTS = [
    (kind, name) for kind in COMPONENTS for name, field in kind.model_fields.items()
    if "Constant" in str(field.annotation) or "Positive" in str(field.annotation)
]  # fmt: skip


def test_every_constant_has_bounds():
    assert len(CONSTANTS) > 75
    for kind, name in CONSTANTS:
        for value in (-1e9, 2e9, 1e300):
            with pytest.raises(ValidationError) as caught:
                kind.model_validate({name: {"value": value, "source": "own"}})
            messages = {error["loc"][0]: error["msg"] for error in caught.value.errors()}
            assert "out of range" in messages[name] or "greater than 0" in messages[name]


def test_a_slip_of_the_pen_is_refused_in_one_line(own_file):
    file = own_file("machines", "agiecut-dem15", ("value = 3.0e-6, range = [1.2e-6, 7.2e-6]", "value = 1e9"))
    with pytest.raises(InputError, match=r"impulse_10mJ_Ns.*1e\+09 is out of range: it must be within 0..0.001"):
        Machine.load(file)
    wide = own_file("machines", "agiecut-dem15", ("range = [1.2e-6, 7.2e-6]", "range = [1.2e-6, 7.2]"))
    with pytest.raises(InputError, match=r"7\.2 is out of range"):  # the range of random draws is checked, too
        Machine.load(wide)
    never = own_file("machines", "agiecut-dem15", ("median_c_us = { value = 14.05", "median_c_us = { value = 7.0"))
    with pytest.raises(InputError, match="must be above zero at every gap"):
        Machine.load(never)


@pytest.mark.parametrize("impulse_Ns", [1e-3, 1.0, 1e9, 1e300])
def test_a_wire_kicked_beyond_all_bounds_ends_as_an_error(impulse_Ns):
    """Beyond the limits of the files, to test the loop itself, which aborted the interpreter."""
    plant = Plant(with_values(Machine.load(), {"discharge.impulse_10mJ_Ns": impulse_Ns}), 1, resolution="fast")

    def push():
        for window in range(200):
            plant.advance([(plant.time_ns, 0, 1)] if window % 3 == 0 else [])

    with pytest.raises(PlantError):
        push()


def plant_at_work(**options):
    plant = Plant(Machine.load(), 1, resolution="fast", **options)
    for _ in range(20):
        plant.advance([(plant.time_ns, 0, 1)])
    return plant


ALTERED: dict[str, Callable[[dict[str, np.ndarray[Any, Any]]], None]] = {
    "last_ray": lambda s: s["state"].__setitem__("last_ray", 10**6),
    "last_slice": lambda s: s["state"].__setitem__("last_slice", -5),
    "broken_slice": lambda s: s["state"].__setitem__("broken_slice", 99),
    "time_ns": lambda s: s["state"].__setitem__("time_ns", -1), "first": lambda s: s["first"].__setitem__(0, 4096),
    "blocks": lambda s: s["blocks"].__setitem__(0, 10**9), "unbroken": lambda s: s["unbroken"].__setitem__(0, -1),
    "wire_q": lambda s: s["wire_q"].__setitem__((0, 0), np.nan),
    "temperature_K": lambda s: s["temperature_K"].__setitem__(0, np.inf),
    "state": lambda s: s["state"].__setitem__("axis_um", np.nan),
    "index and its tiles": lambda s: s["field.index"].__setitem__((3, 3), 12345),
    "a cell": lambda s: s["field.tiles"].__setitem__((0, 0, 0, 0), 65535),
    "debris": lambda s: s.__setitem__("debris", s["debris"][:-1]),
    "distance": lambda s: s.__setitem__("distance", s["distance"].astype(np.float64)),
    "steam": lambda s: s.__delitem__("steam"),
    "due at": lambda s: s["drives"].__setitem__("due_ns", -(10**15)),
    "period is": lambda s: s["drives"].__setitem__("den", 0),
}  # fmt: skip


@pytest.mark.parametrize("named", ALTERED)
def test_an_altered_snapshot_is_refused(named):
    plant = plant_at_work(drives={"x": axis.from_text("uhu")})
    snapshot = plant.snapshot()
    ALTERED[named](snapshot)
    fresh = Plant(Machine.load(), 1, resolution="fast", drives={"x": axis.from_text("uhu")})
    before = fresh.snapshot()
    with pytest.raises(InputError, match=named) as caught:
        fresh.restore(snapshot)
    assert "\n" not in str(caught.value)
    np.testing.assert_equal(fresh.snapshot(), before)  # the plant is unchanged


@pytest.mark.parametrize(("options", "drives"), [
    ({"material": "copper"}, {}), ({"tension": 9.0}, {}), ({"open_voltage_V": 90.0}, {}),
    ({}, {"x": axis.from_text("uhu")}),
])  # fmt: skip
def test_a_snapshot_of_another_set_up_is_refused(options, drives):
    other = Plant(Machine.load(**options), 1, resolution="fast", drives=drives)
    with pytest.raises(InputError, match="snapshot of another set-up"):
        Plant(Machine.load(), 1, resolution="fast").restore(other.snapshot())


def test_random_changes_of_a_snapshot_never_leave_the_arrays():
    """A hundred snapshots with some numbers replaced by random bits are refused, or run, or end with an error."""
    sound, rng, refused = plant_at_work().snapshot(), np.random.default_rng(5), 0
    plant = Plant(Machine.load(), 1, resolution="fast")
    names = [name for name in sound if sound[name].size]
    for _ in range(100):
        altered = {name: value.copy() for name, value in sound.items()}
        for name in rng.choice(names, 3):
            raw = altered[name].reshape(-1).view(np.uint8)
            at = 8 * int(rng.integers(max(raw.size // 8, 1)))
            raw[at : at + 8] = rng.integers(0, 256, raw[at : at + 8].size)
        try:
            plant.restore(altered)
            for _ in range(3):
                plant.advance()
        except (InputError, PlantError):
            refused += 1
            plant.reset(1)
    assert 20 < refused < 100


def test_a_plant_whose_wire_broke_refuses_to_go_on():
    """Such a plant fired windows of one pulse each."""
    weak = {"wire.half_strength_K": 300.0, "wire.strength_MPa": 220.0}  # beyond the limits: breaks when warm
    plant = Plant(with_values(Machine.load(), weak), 1, resolution="fast")
    window = plant.advance()
    while not window.broken:
        window = plant.advance([(plant.time_ns, 0, 1)])
    assert 293 < window.wire_temperature_K <= plant.machine.wire.melting_K.value
    snapshot = plant.snapshot()
    with pytest.raises(WireBrokenError, match="the wire is broken: thread a new one") as caught:
        plant.advance()
    assert caught.value.window.broken
    np.testing.assert_equal(plant.snapshot(), snapshot)
    plant.rethread(plant.commanded_um, 1_000_000_000)
    assert 0 < plant.advance().pulses <= 255


# --- arrays of the loop are declared once; allocation refuses other declarations ---

SIZES = sizes_of(5, 24, 4)


def test_allocated_arrays_are_as_declared():
    a = allocate(Arrays, SIZES)
    assert a.edge_um.shape == (5, 24)
    assert a.edge_um.dtype == np.float32
    assert a.sway.shape == (4, 8)
    assert a.first.dtype == np.int64
    assert not any(array.any() or array.ctypes.data % 64 for array in a)  # zeros, each on a cache line of its own
    assert len({array.ctypes.data for array in a}) == len(a)


@pytest.mark.parametrize(
    ("name", "wrong"), [("wire_q", np.zeros((2, 3))), ("edge_um", np.zeros((5, 24))), ("sway", np.zeros((8, 4)).T)]
)
def test_memory_refuses_another_shape_type_or_order(name, wrong):
    with pytest.raises(TypeError, match=name):
        Memory(SIZES).put(allocate(Arrays, SIZES)._replace(**{name: wrong}))


def test_an_array_has_the_dtype_of_its_type_however_numpy_spells_it():
    class Group(NamedTuple):
        until_2_4: Annotated[np.ndarray[tuple[int], np.dtype[np.int32]], Stored("rays")]
        from_2_5: Annotated[GenericAlias(np.ndarray, (np.int32,)), Stored("rays")]

    assert [field.dtype for field in fields_of(Group)] == ["i4", "i4"]
