"""Set-ups of several checks: changed constants, a straight cut at fixed feed, a hole of known gap."""

from collections.abc import Iterable, Mapping
from typing import Any

from edmsim.closed_loop.straight import Cut, cut_straight
from edmsim.controllers import from_text
from edmsim.errors import InputError
from edmsim.evaluation.stable_rate import OPEN_SHARE, quick_counts
from edmsim.machine.components import Constant
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.plant.plant import Plant
from edmsim.plant.workpiece.kerf_field import Stock

STILL: Mapping[str, float] = {
    "material.removal_mm3_J": 1e-15,
    "material.magnetic_share": 0.0,
    "base.discharge.impulse_10mJ_Ns": 0.0,
    "base.discharge.bubble_share": 1e-12,
    "base.gas.steam_share": 0.0,
    "base.gas.permanent_share": 0.0,
    "base.cooling.wire_heat_share": 0.0,
    "base.dielectric.conductivity_uS_cm": 1e-9,
    "base.dielectric.gap_temperature_K": 293.15,
    "base.dielectric.permittivity": 1e-6,
    "base.dielectric.jet_drag": 0.0,
    "base.dielectric.film_stirring": 1.0,
}
"""Constants with which pulses break down and have (nearly) no other effect: no removal, motion or heat, no gas, no
force of jets, and water of 20 C without eddies."""
UNBREAKABLE: Mapping[str, float] = {"wire.half_strength_K": 1e6}
"""A wire that heat does not weaken, for rows on its position."""


def altered(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return a machine with constants replaced, also outside their range: ``{"base.gap.critical_um": 9.0}``."""
    for path, value in values.items():
        machine = _replaced(machine, path.split("."), value, path)
    return machine


def _replaced(part: Any, keys: list[str], value: float, path: str) -> Any:
    old = getattr(part, keys[0], None)
    if len(keys) > 1 and old is not None:
        new = _replaced(old, keys[1:], value, path)
    elif len(keys) == 1 and isinstance(old, Constant):
        new = type(old)(value=value, source="set for a check")
    else:
        raise InputError(f"a machine has no constant '{path}'; a place reads like base.gap.critical_um")
    return part.model_copy(update={keys[0]: new})


def with_on_time(machine: Machine, t_on_us: float) -> Machine:
    """Return a machine with another on-time, the same peak and the same pause."""
    return machine.with_(t_on_us=t_on_us, t_period_us=t_on_us + machine.t_period_us - machine.t_on_us)


def in_a_hole(machine: Machine, gap_um: float, seed: int, *, resolution: str = "fast") -> Plant:
    """Return a plant with its wire in the middle of a round hole, with the same gap all around."""
    centre_um = x, y = machine.base.table.centre_um
    radius = machine.wire_diameter_um / 2 + gap_um
    stock = Stock((x - 3_000, y - 3_000, x + 3_000, y + 3_000), ((x, y, radius),))
    return Plant(machine, seed, stock=stock, position_um=centre_um, resolution=resolution)


def load_debris(plant: Plant, share: float) -> None:
    """Set the share of debris in the gap's water, in all slices."""
    state = plant.snapshot()
    state["debris"][: plant.resolution.slices] = share
    plant.restore(state)


NO_IGNITION: Mapping[str, float] = {"base.gap.median_a_us_um2": 1e12, "base.gap.median_c_us": 1e15}
"""A gap with long delays beyond all pulses, so only primed sites ignite."""


FRAIL: Mapping[str, float] = {"wire.strength_MPa": 1e-6}  # breaks at its first discharge: see `single_discharges`


def single_discharges(plant: Plant, count: int) -> list[PulseWindow]:
    """Fire until the first discharge, each time with a new wire, so every window has at most one discharge."""
    # windows without a discharge, in which all pulses are open, are included
    windows = []
    for _ in range(count):
        plant.rethread(plant.commanded_um, 0)
        windows.append(plant.advance())
    return windows


PRACTICE = "usual of wire EDM practice (no published table)"
"""Source of facts that are known in shops, but without a published table; the fact follows this text."""


def servo_cut(machine: Machine, seed: int, *, open_share: float = OPEN_SHARE, seconds: float = 3.0) -> Cut:
    """Cut straight with a servo that holds a share of open pulses: a count law, fast enough for dense pulses."""
    # by default 0.1, as in the search for the highest stable rate
    return cut_straight(machine, from_text(quick_counts(open_share)), seed, settle_s=seconds, seconds=seconds)


def servo_cuts(machine: Machine, seeds: Iterable[int], **servo: float) -> list[Cut]:
    """Return a `servo_cut` with every seed."""
    return [servo_cut(machine, seed, **servo) for seed in seeds]


CAPACITY_SHARE = 0.85
"""Greatest fixed feed as a share of the feed that a servo reaches (ours): above it a lagging wire jams permanently,
because without sparks nothing pushes it back and its tension presses it against the metal."""


def capacity_um_s(machine: Machine) -> float:
    """Return the feed that a servo reaches in a set-up with a tenth of open pulses; one cut, seed 1."""
    return servo_cut(machine, 1, seconds=6.0).feed_um_s


def feed_within(feed_um_s: float, *machines: Machine) -> float:
    """Return a fixed feed, but at most `CAPACITY_SHARE` of the least capacity of its set-ups."""
    return min(feed_um_s, *(CAPACITY_SHARE * capacity_um_s(machine) for machine in machines))

