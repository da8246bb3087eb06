"""The setting of a set-up, from the operator's options or the files' constants, and its checks."""

import math
from typing import NamedTuple

from edmsim.errors import CombinationError, InputError, refuse_unknown
from edmsim.machine.components import Constant, SetUp
from edmsim.machine.options import Choices, SetUpOptions, bare_name, limits_of, unit_of

WINDOW_PULSES = 255  # pulses of a window: the cycle of the analyser that counts them (row T-40)
AIR_SHARE = 0.9  # share of open pulses above which no metal is near the wire (ours)
MOST_TIME_S = 1e9  # longest machine time, in ns: 30 years (ours: a tenth of int64)
WIRE_DIAMETER_UM = (20.0, 400.0)  # wire diameters of the field (thesis 1982, section 2.7.1)
TENSION_N = (0.01, 300.0)  # ours: from 20 um copper up to the breaking force of 400 um molybdenum
LIMITS = limits_of(SetUpOptions)  # limits of the options of a set-up, by name
HELD_WIRE_UM = 250.0  # diameter of the wire for which the settings of the package's generators are safe
LEAST_FLUSHING_PA = 100.0  # 1 cm of water (ours): a lower pressure above 0 was probably meant in another unit


class PulseForm(NamedTuple):
    """Form of a discharge's current: mean over peak, and mean square over squared mean."""

    mean: float
    square: float


PULSE_FORMS = {"rectangle": PulseForm(1.0, 1.0), "triangle": PulseForm(1 / 2, 4 / 3)}
"""By pulse shape; a triangle rises and falls linearly: its charge is I t/2, the integral of i^2 is I^2 t/3."""


def _in_force(chosen: float | None, constant: Constant) -> float:
    return constant.value if chosen is None else chosen


def pulse_shape(machine: SetUp) -> str:
    """Return the name of the shape of a discharge's current."""
    return machine.generator.pulse_shape if machine.pulse_shape is None else machine.pulse_shape


def pulse_form(machine: SetUp) -> PulseForm:
    """Return the form of a discharge's current."""
    return PULSE_FORMS[pulse_shape(machine)]


def open_V(machine: SetUp) -> float:
    """Return the voltage on the gap until it ignites."""
    return _in_force(machine.open_voltage_V, machine.generator.open_voltage_V)


def supply_V(machine: SetUp) -> float:
    """Return the voltage of the discharge's supply: the open voltage unless the generator has a second supply."""
    second = machine.generator.supply_voltage_V
    return open_V(machine) if second is None else second.value


def _driving_V(machine: SetUp) -> float:
    """Return the voltage on the series resistance while the gap burns."""
    return supply_V(machine) - machine.material.burning_voltage_V.value


def most_current_A(machine: SetUp) -> float:
    """Return the greatest peak current: that through the generator's own resistor (row T-4)."""
    return _driving_V(machine) / machine.generator.resistance_ohm.value


def resistance_ohm(machine: SetUp) -> float:
    """Return the resistance in series with the gap; a lower peak current needs more of it."""
    if machine.peak_current_A is not None:
        return _driving_V(machine) / machine.peak_current_A
    return _in_force(machine.resistance_ohm, machine.generator.resistance_ohm)


def discharge_current_A(machine: SetUp) -> float:
    """Return the mean current of a discharge: the peak (u(i) - u(e)) / R (row T-4) times the mean of the shape."""
    return _driving_V(machine) / resistance_ohm(machine) * pulse_form(machine).mean


def short_current_A(machine: SetUp) -> float:
    """Return the mean current of a short over the on-time, without burning voltage; the generator may limit it."""
    share = machine.generator.short_current_share
    full = supply_V(machine) / resistance_ohm(machine) * pulse_form(machine).mean
    return full if share is None else share.value * full


def arc_share(machine: SetUp) -> float:
    """Return the duration of an arc over that of a spark."""
    share = machine.generator.arc_share
    return 1.0 if share is None else share.value


def mean_current_A(machine: SetUp) -> float:
    """Return the modelled mean current of a setting if all pulses ignite at once: I t(i) / t(p) (row T-35)."""
    return discharge_current_A(machine) * machine.t_on_us / machine.t_period_us


def least_period_us(machine: SetUp, t_on_us: float) -> float:
    """Return the shortest period for an on-time within the supply's mean current (rows T-34, T-35)."""
    return discharge_current_A(machine) * t_on_us / machine.generator.mean_current_limit_A.value


def held_period_us(machine: SetUp) -> float:
    """Return the shortest period with at most the mean current density of the generator's own setting."""
    # a brass wire of `HELD_WIRE_UM` survives this setting from the start hole on, at usual heights
    own = machine.generator
    usual = machine.model_copy(update={
        "t_on_us": own.t_on_us.value, "t_period_us": own.t_period_us.value, **dict.fromkeys(Choices.model_fields),
    })  # fmt: skip
    thinner = (HELD_WIRE_UM / machine.wire_diameter_um) ** 2
    return machine.t_period_us * thinner * mean_current_A(machine) / mean_current_A(usual)


def ignition_wait_us(machine: SetUp) -> float:
    """Return the longest time to ignition; for a pulse of fixed duration, the on-time."""
    own = machine.generator.ignition_wait_us
    return machine.t_on_us if own is None else _in_force(machine.ignition_wait_us, own)


def busy_us(machine: SetUp) -> float:
    """Return the least time of a pulse that must fit into a period."""
    waits = machine.generator.mode == "ignition-pulse"
    return machine.t_on_us + (ignition_wait_us(machine) if waits else 0.0)


def period_range_us(machine: SetUp) -> tuple[float, float]:
    """Return the shortest and longest period of the generator."""
    return machine.generator.t_period_us.range or LIMITS["t_period_us"].range


def wire_speed_m_s(machine: SetUp) -> float:
    """Return the speed of the running wire."""
    return _in_force(machine.wire_speed_m_s, machine.base.guides.wire_speed_m_s)


def flushing_Pa(machine: SetUp) -> tuple[float, float]:
    """Return the set pressures of the lower and the upper nozzle over the surroundings; by default the machine's."""
    # the pressures at the workpiece are `edmsim.plant.constants.faces_Pa`
    own = machine.base.dielectric.flushing_pressure_Pa
    return _in_force(machine.flushing_lower_Pa, own), _in_force(machine.flushing_upper_Pa, own)


def standoffs_mm(machine: SetUp) -> tuple[float, float]:
    """Return the distances of the lower and the upper nozzle from the workpiece; by default 0."""
    return machine.standoff_lower_mm or 0.0, machine.standoff_upper_mm or 0.0


class GuideBends(NamedTuple):
    """Places where a tilted wire bends."""

    stiff_mm: float  # distance inside the guides, by the wire's stiffness
    # radius of the guides' edges, which moves the bend further inside by radius times tan(angle / 2)
    radius_mm: float
    # height of the guides over that known to the control
    lower_error_mm: float
    upper_error_mm: float


def guide_bends(machine: SetUp) -> GuideBends:
    """Return where a tilted wire bends: a clamped wire approaches its line within ``sqrt(E I / T)``."""
    modulus, guides = machine.wire.elasticity_GPa, machine.base.guides
    second_moment_mm4 = math.pi / 64 * (machine.wire_diameter_um * 1e-3) ** 4
    bending_N_mm2 = 0.0 if modulus is None else modulus.value * 1e3 * second_moment_mm4
    return GuideBends(
        math.sqrt(bending_N_mm2 / machine.tension), guides.value("edge_radius_mm"), guides.value("lower_error_mm"),
        guides.value("upper_error_mm"),
    )


def check(machine: SetUp) -> None:
    """Raise `InputError` for a set-up that cannot run."""
    low, high = WIRE_DIAMETER_UM
    if not low <= machine.wire_diameter_um <= high:
        meant_um = machine.wire_diameter_um * 1e3
        hint = f"; {machine.wire_diameter_um:g} mm are {meant_um:g} um" if low <= meant_um <= high else ""
        raise InputError(f"wire diameter {machine.wire_diameter_um:g} um is not within {low:g}..{high:g} um{hint}")
    check_height(machine.height_mm)
    low, high = TENSION_N
    if not low <= machine.tension <= high:
        raise InputError(f"wire tension {machine.tension:g} N is not within {low:g}..{high:g} N")
    if machine.tension >= machine.breaking_force:
        raise InputError(f"wire tension {machine.tension:g} N breaks the {machine.wire_diameter_um:g} um "
                         f"{machine.wire_name} wire at rest: it holds {machine.breaking_force:.3g} N")
    _check_choices(machine)
    check_pulses(machine)


def check_pulses(machine: SetUp) -> None:
    """Raise `InputError` for an on-time or a period that the generator refuses."""
    _check_times(machine)
    _check_currents(machine)


def check_height(height_mm: float, where: str = "") -> None:
    """Raise `InputError` for an impossible workpiece height; `where` ends the message's subject."""
    _check_limit("height_mm", height_mm, where=where)


def _check_limit(name: str, value: float, own: Constant | None = None, where: str = "") -> None:
    """Refuse a value outside an option's limits; a range of the generator's constant replaces these."""
    limits, unit = LIMITS[name], unit_of(name)
    low, high = limits.range if own is None or own.range is None else own.range
    if not low <= value <= high:
        what = limits.what or bare_name(name).replace("_", " ")
        raise InputError(f"{what} {value:g} {unit}{where} is not within {low:g}..{high:g} {unit}")


def _check_choices(machine: SetUp) -> None:
    """Refuse choices outside their limits, that exclude each other, or that the generator does not have."""
    mode = machine.generator.mode
    for name in Choices.model_fields:
        if name in LIMITS and (value := getattr(machine, name)) is not None:
            _check_limit(name, value, getattr(machine.generator, name, None))
            if name.startswith("flushing") and 0 < value < LEAST_FLUSHING_PA:
                raise InputError(f"{LIMITS[name].what} {value:g} Pa is almost none: {value:g} bar are "
                                 f"{value * 1e5:g} Pa, and 0 switches the nozzle off")
    if machine.peak_current_A is not None and machine.resistance_ohm is not None:
        raise InputError("peak current and resistance are both given: choose one, as it decides on the other")
    if machine.ignition_wait_us is not None and mode == "iso-pulse":
        raise InputError("an iso-pulse generator has no ignition wait: its switch opens at t_on, ignited or not")
    shape = pulse_shape(machine)
    refuse_unknown("pulse shape", shape, PULSE_FORMS)
    if shape == "triangle" and mode == "iso-pulse":
        raise InputError("an iso-pulse generator makes no triangles: the switch would cut them off; choose "
                         "iso-energetic or ignition-pulse, whose discharges all last t_on")


def _check_times(machine: SetUp) -> None:
    """Refuse on-times and periods outside the generator's limits, or without a pause (rows T-1, T-2, T-36)."""
    for name in ("t_on_us", "t_period_us"):
        _check_limit(name, getattr(machine, name), getattr(machine.generator, name))
    busy = busy_us(machine)
    if busy >= machine.t_period_us:
        raise CombinationError(f"t_period {machine.t_period_us:g} us leaves no pause after {busy:g} us of pulse")


def _check_currents(machine: SetUp) -> None:
    """Refuse voltages too low for a discharge, and currents above the supply's limit (rows T-34, T-35)."""
    burning = machine.material.burning_voltage_V.value
    for name, voltage in (("open", open_V(machine)), ("supply", supply_V(machine))):
        if voltage <= burning:
            raise CombinationError(f"{name} voltage {voltage:g} V is not above the burning voltage of {burning:g} V")
    if machine.peak_current_A is not None and machine.peak_current_A > most_current_A(machine) * (1 + 1e-9):
        raise CombinationError(f"peak current {machine.peak_current_A:g} A is above the "
                               f"{most_current_A(machine):.4g} A that {supply_V(machine):g} V drive through the "
                               f"generator's {machine.generator.resistance_ohm.value:g} ohm against {burning:g} V; "
                               "choose less, or a lower resistance")
    limit = machine.generator.mean_current_limit_A.value
    if mean_current_A(machine) > limit + 1e-9:
        least_us = math.ceil(100 * least_period_us(machine, machine.t_on_us)) / 100  # a rounded one may draw too much
        raise CombinationError(f"t_on {machine.t_on_us:g} us in t_period {machine.t_period_us:g} us draws "
                               f"{mean_current_A(machine):.5g} A, above the generator's {limit:g} A; t_period must "
                               f"be at least {least_us:g} us")
