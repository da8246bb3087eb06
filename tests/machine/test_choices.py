"""What an operator chooses in place of a file's constant: it holds, it can be taken back, and it has limits."""

import math

import pytest

from edmsim.errors import InputError
from edmsim.job.options import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.options import bare_name, unit_of
from edmsim.machine.setting import (
    LIMITS,
    discharge_current_A,
    flushing_Pa,
    ignition_wait_us,
    least_period_us,
    mean_current_A,
    open_V,
    resistance_ohm,
    short_current_A,
    standoffs_mm,
    wire_speed_m_s,
)


def refusal(**choices):
    with pytest.raises(InputError) as caught:
        Machine.load(**choices)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_without_a_choice_the_files_hold():
    machine = Machine.load(generator="iso-energetic")
    generator, base = machine.generator, machine.base
    assert open_V(machine) == generator.open_voltage_V.value
    assert resistance_ohm(machine) == generator.resistance_ohm.value
    assert generator.ignition_wait_us is not None
    assert ignition_wait_us(machine) == generator.ignition_wait_us.value
    assert wire_speed_m_s(machine) == base.guides.wire_speed_m_s.value
    assert flushing_Pa(machine) == (base.dielectric.flushing_pressure_Pa.value,) * 2
    assert standoffs_mm(machine) == (0.0, 0.0)


def test_a_choice_holds_in_place_of_the_constant_and_none_takes_it_back():
    usual = Machine.load(generator="iso-energetic")
    machine = Machine.load(
        generator="iso-energetic", open_voltage_V=110.0, ignition_wait_us=33.0, wire_speed_m_s=0.25,
        flushing_lower_Pa=0.0, flushing_upper_Pa=4e5, standoff_lower_mm=2.0, standoff_upper_mm=0.3, t_on_us=10.0,
    )  # fmt: skip
    assert (open_V(machine), ignition_wait_us(machine), wire_speed_m_s(machine)) == (110.0, 33.0, 0.25)
    assert flushing_Pa(machine) == (0.0, 4e5)  # as set, whatever the stand-off leaves
    assert standoffs_mm(machine) == (2.0, 0.3)
    assert machine.generator == usual.generator  # the files stay what they are
    assert machine.base == usual.base
    back = machine.with_(open_voltage_V=None, ignition_wait_us=None, wire_speed_m_s=None, flushing_lower_Pa=None,
                         flushing_upper_Pa=None, standoff_lower_mm=None, standoff_upper_mm=None,
                         t_on_us=usual.t_on_us)  # fmt: skip
    assert back == usual


def test_the_peak_current_is_chosen_by_resistance_and_shorts_follow():
    machine = Machine.load(peak_current_A=3.0)
    assert discharge_current_A(machine) == pytest.approx(3.0)
    assert resistance_ohm(machine) == pytest.approx(78.0 / 3.0)
    assert short_current_A(machine) == pytest.approx(3.0 * 100.0 / 78.0)
    assert discharge_current_A(Machine.load(resistance_ohm=78.0 / 3.0)) == pytest.approx(3.0)


def test_a_generator_may_cut_the_current_of_shorts(own_file):
    machine = Machine.load("production", generator="production")
    assert short_current_A(machine) == pytest.approx(0.2 * 300.0 / 0.397 / 2)
    file = own_file("generators", "production", ("share = { value = 0.2,", "share = { value = 1.0,"))
    whole = Machine.load("production", generator=file)
    assert short_current_A(whole) == pytest.approx(300.0 / 0.397 / 2)
    assert discharge_current_A(whole) == discharge_current_A(machine)


def test_the_resistor_lets_more_through_at_a_higher_open_voltage():
    assert Machine.load(open_voltage_V=120.0, peak_current_A=8.0, t_period_us=150.0).peak_current_A == 8.0
    assert "8 A is above the 6.61 A that 100 V drive" in refusal(peak_current_A=8.0, t_period_us=150.0)


def test_a_triangle_has_half_the_mean_current_and_so_half_the_shortest_period():
    rectangle, triangle = (
        Machine.load(generator="iso-energetic", pulse_shape=shape) for shape in ("rectangle", "triangle")
    )
    for of in (discharge_current_A, short_current_A, mean_current_A, lambda m: least_period_us(m, 20.0)):
        assert of(triangle) == pytest.approx(of(rectangle) / 2)
    assert rectangle.with_(pulse_shape="triangle", t_period_us=0.6 * least_period_us(rectangle, 20.0)) == (
        triangle.with_(t_period_us=0.6 * least_period_us(rectangle, 20.0))
    )


def test_a_choice_of_the_other_kind_takes_the_place_of_the_first():
    machine = Machine.load(peak_current_A=3.0)
    assert discharge_current_A(machine.with_(peak_current_A=None, resistance_ohm=39.0)) == pytest.approx(2.0)
    with pytest.raises(InputError, match="both given"):
        machine.with_(resistance_ohm=39.0)


@pytest.mark.parametrize(("options", "said"), [
    ({"peak_current_A": 6.7}, "peak current 6.7 A is above the 6.61 A that 100 V drive through the generator's "
                              "11.8 ohm against 22 V; choose less, or a lower resistance"),
    ({"peak_current_A": 3.0, "resistance_ohm": 20.0}, "peak current and resistance are both given"),
    ({"resistance_ohm": 5.0}, "above the generator's 2 A"),
    ({"open_voltage_V": 59.0}, "open voltage 59 V is not within 60..120 V"),
    ({"open_voltage_V": 20.0, "generator": "ignition-pulse"}, "open voltage 20 V is not above the burning volt"),
    ({"open_voltage_V": 501.0, "generator": "ignition-pulse"}, "open voltage 501 V is not within 10..500 V"),
    ({"ignition_wait_us": 20.0}, "an iso-pulse generator has no ignition wait"),
    ({"ignition_wait_us": 80.0, "generator": "ignition-pulse"}, "t_period 100 us leaves no pause after 100 us"),
    ({"pulse_shape": "triangle"}, "an iso-pulse generator makes no triangles"),
    ({"pulse_shape": "triangle", "generator": "iso-energetic", "t_on_us": 90.0},
     "t_period 90 us leaves no pause after 90 us"),
    ({"pulse_shape": "sine", "generator": "iso-energetic"}, "unknown pulse shape 'sine'; there are: rectangle"),
    ({"flushing_lower_Pa": -1.0}, "pressure of the lower nozzle -1 Pa is not within 0..3e+06 Pa"),
    ({"flushing_upper_Pa": 2.0}, "upper nozzle 2 Pa is almost none: 2 bar are 200000 Pa, and 0 switches"),
    ({"standoff_lower_mm": -0.1}, "stand-off of the lower nozzle -0.1 mm is not within 0..100 mm"),
    ({"standoff_upper_mm": 101.0}, "stand-off of the upper nozzle 101 mm is not within 0..100 mm"),
])  # fmt: skip
def test_a_choice_that_cannot_run_is_refused_in_one_line(options, said):
    assert said in refusal(**options)


@pytest.mark.parametrize("name", LIMITS)
def test_choices_have_limits(name):
    limit = LIMITS[name]
    for value in (limit.low - 1.0, 1.01 * limit.high, math.nan, math.inf, -math.inf):
        text = refusal(**{name: value, "generator": "iso-energetic"})
        assert f"{limit.what or bare_name(name).replace('_', ' ')} {value:g} {unit_of(name)} is not within" in text


def test_a_generator_s_own_ranges_hold_in_place_of_the_field_s(own_file):
    file = own_file(
        "generators", "iso-energetic", ("value = 20.0, range = [1.0, 1000.0]", "value = 20.0, range = [0.2, 25.0]"),
        ("{ value = 60.0, source", "{ value = 60.0, range = [10.0, 80.0], source"),
    )  # fmt: skip
    assert Machine.load(generator=file, t_on_us=0.3).t_on_us == 0.3
    assert "t_on 26 us is not within 0.2..25 us" in refusal(generator=file, t_on_us=26.0)
    assert "ignition wait 81 us is not within 10..80 us" in refusal(generator=file, ignition_wait_us=81.0)


def test_a_triangle_is_no_shape_of_an_own_iso_pulse_generator(own_file):
    file = own_file("generators", "iso-pulse", ('mode = "iso-pulse"', 'mode = "iso-pulse"\npulse_shape = "triangle"'))
    assert "makes no triangles" in refusal(generator=file)


def test_an_overridden_constant_is_in_force_and_not_drawn():
    settings = CutSettings(constants={"gap.critical_um": 5.5, "wire.strength_MPa": 1000})
    machine = settings.load_machine()
    assert machine.base.gap.critical_um.value == 5.5
    assert machine.wire.strength_MPa.value == 1000.0
    assert {"gap.critical_um", "wire.strength_MPa"}.isdisjoint(machine.uncertain())
    assert CutSettings.of_json(settings.model_dump_json()).load_machine() == machine
    table = CutSettings(constants={"geometry.x_pitch_um_m": 10}).load_machine()  # of which our file has none
    assert table.base.geometry.value("x_pitch_um_m") == 10.0


@pytest.mark.parametrize(("constants", "named"), [
    ({"gap.colour": 1}, "gap.critical_um"), ({"colour": 1}, "gap.*"), ({"gap.critical_um": -1}, "gap.critical_um"),
    ({"gap.critical_um": float("nan")}, "gap.critical_um"), ({"wire.default_diameter_um": 200}, "brass-200"),
    ({"geometry.x_periodic_um": 2}, "lead_mm"), (3, "{'gap.critical_um': 5.0}"),
    ({"gap.critical_um": 1e5}, "gap.critical_um cannot be 100000"), ({"guides.lower_error_mm": 9}, "within -5..5"),
    ({"wire.heat_capacity_J_kgK": 1e-6}, "within 50..5000"), ({"material.magnetic_share": 50}, "within -1..1"),
])  # fmt: skip
def test_a_constant_that_cannot_be_is_refused_in_one_line(constants, named):
    with pytest.raises(InputError) as refused:
        CutSettings(constants=constants).load_machine()
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)
