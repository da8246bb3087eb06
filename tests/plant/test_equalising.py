"""Equalising pulses at the gap: mean voltage of 0 V and its limits, power, and refused settings."""

from pathlib import Path

import numpy as np
import pytest
import shapely

import edmsim
from edmsim.plant.gap.generator import pulse_lengths_us
from edmsim.plant.workpiece.height_steps import LowerRegion
from edmsim.plant.workpiece.kerf_field import Stock

# a straight edge 12 um in front of the wire: sparks, opens and, as it is driven on, contacts
STOCK = Stock((32_500.0 + 125.0 + 12.0, 0.0, 65_000.0, 65_000.0))
LOW = Stock(STOCK.rectangle_um, lower_regions=(LowerRegion(shapely.box(*STOCK.rectangle_um), 10.0),), height_mm=30.0)
SUPPLY = """
[equalising]
voltage_V = { value = 80.0, source = "a test" }
resistance_ohm = { value = 400.0, source = "a test" }
"""


def driven(plant, windows=8, steps=2):
    """Advance with motor steps of 2 um in every window; yield the window and its equalising pulses."""
    for _ in range(windows):
        now = plant.time_ns
        window = plant.advance([(now + 1_000_000 * (n + 1), 0, 1) for n in range(steps)])
        yield window, plant.opposite_pulses()


def with_supply(own_file, name, supply=SUPPLY):
    """Return the file of a generator with a supply for equalising pulses."""
    file = Path(own_file("generators", name))
    file.write_text(file.read_text(encoding="utf-8") + supply, encoding="utf-8")
    return str(file)


# T-12
@pytest.mark.parametrize("name", ["iso-pulse", "iso-energetic", "ignition-pulse"])
def test_the_mean_gap_voltage_is_0_and_the_cut_the_same(name, own_file):
    machines = [edmsim.Machine.load(height_mm=5.0, generator=g) for g in (name, with_supply(own_file, name))]
    plain, equalised = (edmsim.Plant(m, 3, stock=STOCK, resolution="fast") for m in machines)
    kinds = set()
    for (window, nothing), (same, opposite) in zip(driven(plain), driven(equalised), strict=True):
        assert nothing is None
        assert same == window  # a controller observes only the working pulses
        assert opposite.net_voltage_V == pytest.approx(0.0, abs=1e-9)
        duration_us = window.duration_ns * 1e-3
        assert -opposite.voltage_V * opposite.on_us == pytest.approx(window.mean_voltage_V * duration_us)
        assert 0 <= opposite.on_us < duration_us
        kinds |= {kind for kind in ("short", "open", "spark") if getattr(window, kind)}
    assert "spark" in kinds


# T-12
@pytest.mark.parametrize(("on", "period", "left_V"), [(30.0, 100.0, 0.0), (30.0, 80.0, 0.0), (30.0, 40.0, 60.0)])
def test_what_the_pauses_have_no_room_for_is_left(on, period, left_V, in_a_hole):
    # open pulses of 100 V: 3000 V us, which 60 V balance in 50 us
    machine = edmsim.Machine.load(generator="equalising", resistance_ohm=60.0).with_pulses(on, period)
    plant = in_a_hole(machine, 300.0)
    plant.advance()
    assert plant.opposite_pulses().net_voltage_V == pytest.approx(left_V, abs=1e-6)
    assert plant.opposite_pulses().on_us == pytest.approx(255 * min(50.0, period - on), rel=1e-6)


@pytest.mark.parametrize("name", ["equalising", "iso-energetic"])
def test_no_pulse_follows_a_short(name, own_file):
    weak = with_supply(own_file, "iso-energetic", SUPPLY.replace("80.0", "3.0"))  # needs more than all pauses
    machine = edmsim.Machine.load(generator=weak if name == "iso-energetic" else name, height_mm=5.0)
    plant = edmsim.Plant(machine, 3, stock=STOCK, resolution="fast")
    for window, opposite in driven(plant, 40, steps=8):  # faster than 5 mm of steel can be cut
        room_us = (255 - window.short) * 70.0
        if name == "equalising":
            assert opposite.on_us <= room_us + 1e-6
        else:  # its pulses begin on a grid
            assert opposite.on_us == pytest.approx(room_us, abs=255 * 0.08)
        if window.short == 255:
            assert opposite.net_voltage_V == opposite.on_us == opposite.power_W == 0.0
            return
    pytest.fail("the wire was to be pressed to the metal")


# T-86
@pytest.mark.parametrize(("conductivity_uS_cm", "stock"), [(5.0, STOCK), (20.0, STOCK), (20.0, LOW)])
def test_their_supply_gives_what_water_and_resistor_take(conductivity_uS_cm, stock, altered):
    machine = edmsim.Machine.load(generator="equalising", height_mm=30.0)
    machine = altered(machine, {"base.dielectric.conductivity_uS_cm": conductivity_uS_cm})
    plant = edmsim.Plant(machine, 3, stock=stock, resolution="fast")
    window, opposite = plant.advance(), plant.opposite_pulses()
    water_S, share = plant.leakage_S(), opposite.on_us / (window.duration_ns * 1e-3)
    assert opposite.current_A == pytest.approx(opposite.voltage_V * water_S)
    in_water = opposite.voltage_V**2 * water_S * share
    in_resistor = opposite.current_A**2 * 150.0 * share
    assert opposite.power_W == pytest.approx(in_water + in_resistor)
    assert 0 < opposite.power_W < 0.4 * 60.0 * share
    # the same conductance loads the working pulses: 100 V through 11.8 ohm, which lowers the voltage of open pulses
    plant.watch_pulses()
    plant.advance()
    assert plant.last_pulses()["open_V"].max() == pytest.approx(100.0 / (1.0 + 11.8 * water_S), rel=1e-6)


def test_a_generator_that_is_off_gives_none_and_without_a_wire_there_is_no_water():
    plant = edmsim.Plant(edmsim.Machine.load(generator="equalising"), 3, stock=STOCK, resolution="fast")
    plant.advance()
    assert plant.leakage_S() > 0.0
    plant.switch_generator(False)
    plant.advance()
    assert plant.opposite_pulses() is None
    plant.switch_generator(True)
    plant.continue_without_wire()
    window = plant.advance()
    assert window.open == 255
    assert plant.opposite_pulses() == (-60.0, 0.0, pytest.approx(255 * 50.0), pytest.approx(0.0, abs=1e-9), 0.0)


def test_pulse_by_pulse_later_pauses_make_up_for_full_ones():
    integral = np.array([[3000.0, 0.0, 600.0, 0.0], [600.0, 600.0, 600.0, 600.0]])
    room = np.array([[30.0, 30.0, 0.0, 30.0], [70.0, 70.0, 70.0, 70.0]])
    lengths = pulse_lengths_us(integral, room, np.array([60.0, 0.0]))
    np.testing.assert_allclose(lengths, [[30.0, 20.0, 0.0, 10.0], [0.0, 0.0, 0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize(("constants", "says"), [
    ({"voltage_V": 100.0, "resistance_ohm": 100.0}, r"100 V through 100 ohm are 1 A.*raise resistance_ohm"),
    ({"voltage_V": 50.0}, "resistance_ohm"), ({"voltage_V": -50.0, "resistance_ohm": 500.0}, "voltage_V"),
])  # fmt: skip
def test_a_supply_that_could_hold_an_arc_or_is_none_is_refused(constants, says, own_file):
    lines = [f'{name} = {{ value = {value}, source = "own" }}' for name, value in constants.items()]
    with pytest.raises(edmsim.InputError, match=says):
        edmsim.Machine.load(generator=with_supply(own_file, "iso-pulse", "\n".join(["", "[equalising]", *lines])))
