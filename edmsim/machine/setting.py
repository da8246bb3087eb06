"""What of a set-up the wire, the machine and the generator's supply refuse."""

from __future__ import annotations

from edmsim.errors import InputError
from edmsim.machine.parts import SetUp

WIRE_DIAMETER_UM = (20.0, 400.0)
"""Wire diameters of the field (thesis 1982, section 2.7.1)."""
HEIGHT_MM = (0.5, 400.0)
"""Workpiece heights of the field, from sheet to the tallest machines' work areas (ours)."""
T_ON_US = (1.0, 1000.0)
"""On-times of the field (row T-1)."""
T_PERIOD_US = (2.0, 10_000.0)
"""Periods: 500 kHz (row T-36) to 10 ms (row T-2)."""


def supply_V(machine: SetUp) -> float:
    """Voltage of the supply that drives the discharge; the open voltage where the generator has no second one."""
    return (machine.generator.supply_voltage_V or machine.generator.open_voltage_V).value


def discharge_current_A(machine: SetUp) -> float:
    """Current of a discharge: (u(i) - u(e)) / R (row T-4)."""
    return (supply_V(machine) - machine.material.burning_voltage_V.value) / machine.generator.resistance_ohm.value


def mean_current_A(machine: SetUp) -> float:
    """Modelled mean current of a setting, all pulses igniting at once: I t(i) / t(p) (row T-35)."""
    return discharge_current_A(machine) * machine.t_on_us / machine.t_period_us


def least_period_us(machine: SetUp, t_on_us: float) -> float:
    """Shortest period at which the supply gives an on-time without exceeding its mean current (rows T-34, T-35)."""
    return discharge_current_A(machine) * t_on_us / machine.generator.mean_current_limit_A.value


def check(machine: SetUp) -> None:
    """Raise `InputError` for a set-up that cannot run."""
    low, high = WIRE_DIAMETER_UM
    if not low <= machine.wire_diameter_um <= high:
        raise InputError(f"wire diameter {machine.wire_diameter_um:g} um is not within {low:g}..{high:g} um")
    check_height(machine.height_mm)
    if not machine.tension > 0:
        raise InputError(f"wire tension {machine.tension:g} N must be above zero")
    if machine.tension >= machine.breaking_force:
        raise InputError(
            f"wire tension {machine.tension:g} N breaks the {machine.wire_diameter_um:g} um {machine.wire_name} wire "
            f"at rest: it holds {machine.breaking_force:.3g} N"
        )
    check_setting(machine)


def check_height(height_mm: float, where: str = "") -> None:
    """Raise `InputError` for a workpiece height no machine takes; `where` ends the message's subject."""
    low, high = HEIGHT_MM
    if not low <= height_mm <= high:
        raise InputError(f"workpiece height {height_mm:g} mm{where} is not within {low:g}..{high:g} mm")


def check_setting(machine: SetUp) -> None:
    """Raise `InputError` for a setting the generator refuses (rows T-1, T-2, T-34..T-36)."""
    for name, value, (low, high) in (
        ("t_on", machine.t_on_us, T_ON_US),
        ("t_period", machine.t_period_us, T_PERIOD_US),
    ):
        if not low <= value <= high:
            raise InputError(f"{name} {value:g} us is not within {low:g}..{high:g} us")
    wait = machine.generator.ignition_wait_us
    busy = machine.t_on_us + (wait.value if wait and machine.generator.mode == "ignition-pulse" else 0.0)
    if busy >= machine.t_period_us:
        raise InputError(f"t_period {machine.t_period_us:g} us leaves no pause after {busy:g} us of pulse")
    current = discharge_current_A(machine)
    if current <= 0:
        raise InputError(f"open voltage {supply_V(machine):g} V is not above the burning voltage")
    limit = machine.generator.mean_current_limit_A.value
    if mean_current_A(machine) > limit + 1e-9:
        raise InputError(
            f"t_on {machine.t_on_us:g} us in t_period {machine.t_period_us:g} us draws "
            f"{mean_current_A(machine):.2f} A, above the generator's {limit:g} A; t_period must be at least "
            f"{least_period_us(machine, machine.t_on_us):.4g} us"
        )
