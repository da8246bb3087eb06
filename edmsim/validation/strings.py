"""The wire as a string between its guides: static lag, frequencies, and the electrostatic pull on it."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from edmsim import models
from edmsim.machine.machine import Machine
from edmsim.plant.constants import RAY_RANGE_UM, gap_law, modal_model, wire_setup
from edmsim.plant.gap.breakdown import slice_sums
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.mechanics.model import build_model, reduce_model
from edmsim.plant.resolution import resolution
from edmsim.plant.wire import VACUUM_PERMITTIVITY_F_M
from edmsim.validation.rows import Check, Row, worst
from edmsim.validation.setups import altered

STRING = "taut string under a uniform load, closed form"
WAVE = "taut string, f = n / (2 L) sqrt(T / mu)"
CYLINDER = "cylinder before a plane, closed form"

FREQUENCIES_HZ = ((40.0, 1935.0), (80.0, 968.0), (150.0, 516.0))
"""First frequency of 0.25 mm brass of 8500 kg/m3 at 10 N, over the distance of the guides in mm."""


def _worst_rows(
    table: str, at: str, over: str, value: str, simulate: Callable[[float, float], float]
) -> Iterator[tuple[float, int, float, float, str]]:
    """Yield every `at` of a published table, its number of rows, and published, simulated and `over` of the worst."""
    rows = models.published(table)
    for place in sorted({float(row[at]) for row in rows}):
        there = [row for row in rows if float(row[at]) == place]
        compared = ((float(row[value]), simulate(place, float(row[over])), row[over]) for row in there)
        yield place, len(there), *worst(compared)


def static_lag_um(height_mm: float, tension: float) -> float:
    """Deflection at mid-height under 1 N/m over the workpiece, of the modes and slices of the pulse loop."""
    machine = Machine.load(height_mm=height_mm, tension=tension)
    modes = modal_model(machine, resolution("default"))
    slices = len(modes.wire_shape)
    load = np.full(slices, height_mm * 1e-3 / slices)
    return float(modes.wire_shape[slices // 2] @ (modes.wire_shape.T @ load / modes.wire_omega**2)) * 1e6


def check_static_lag(seeds: Sequence[int]) -> list[Row]:
    """All 25 rows of the table; the worst tension of every height is shown."""
    of_heights = _worst_rows("analytic_static_wire_lag", "h_mm", "T_N", "ymax_um_per_N_per_m", static_lag_um)
    return [
        Row.value("wire", f"static lag at 1 N/m, {height:g} mm high (worst of {count} tensions: {tension} N)", STRING,
                  published=published, simulated=simulated, within=0.01, unit="um")
        for height, count, published, simulated, tension in of_heights
    ]


def frequencies_Hz(guide_distance_mm: float) -> list[float]:
    """First four frequencies of the published example's wire, in air."""
    clearance_mm = Machine.load().base.guides.clearance_mm.value
    machine = Machine.load(height_mm=guide_distance_mm - 2 * clearance_mm, tension=10.0)
    in_slot = wire_setup(altered(machine, {"wire.density_kg_m3": 8500.0}))
    model = build_model(replace(in_slot, slot_mass_kg_m=0.0), machine.base.model)
    modes = reduce_model(model, 4, [guide_distance_mm * 0.5e-3])
    return [float(omega) / math.tau for omega in modes.wire_omega]


def check_frequencies(seeds: Sequence[int]) -> list[Row]:
    """First frequency at three guide distances, and the first one's overtones."""
    rows = []
    for distance, published in FREQUENCIES_HZ:
        found = frequencies_Hz(distance)
        modes = range(4) if distance == FREQUENCIES_HZ[0][0] else range(1)
        rows += [
            Row.value(
                "wire", f"frequency {n + 1}, guides {distance:g} mm apart", WAVE, published=(n + 1) * published,
                simulated=found[n], within=0.01, unit="Hz",
            )
            for n in modes
        ]
    return rows


def pull_N_m(gap_um: float, voltage_V: float) -> float:
    """Pull per metre on the default wire before a flat wall, summed over rays as the pulse loop does."""
    machine, res = Machine.load(), resolution("default")
    radius = machine.wire_diameter_um / 2
    angle = 2 * math.pi * np.arange(res.rays) / res.rays
    angle = angle[np.cos(angle) > (radius + gap_um) / (radius + RAY_RANGE_UM)]  # as far as rays look
    gaps = (radius + gap_um) / np.cos(angle) - radius
    sums = np.zeros((1, 4))
    slice_sums(rays_with(gaps, angle), 0, 0.0, 0.0, gap_law(machine, res, voltage_V), sums)
    inverse_square_um2 = float(sums[0, 2])
    girth_per_ray_m = math.pi * machine.wire_diameter_um * 1e-6 / res.rays
    permittivity_F_m = machine.base.dielectric.permittivity.value * VACUUM_PERMITTIVITY_F_M  # at 20 C, as published
    return permittivity_F_m / 2 * voltage_V**2 * inverse_square_um2 * 1e12 * girth_per_ray_m


def check_electrostatic_pull(seeds: Sequence[int]) -> list[Row]:
    """All 25 rows of the table; the worst voltage at every gap is shown."""
    of_gaps = _worst_rows("analytic_electrostatic_force", "gap_um", "V", "force_N_per_m", pull_N_m)
    return [
        Row.value("wire", f"electrostatic pull at {gap:g} um (worst of {count} voltages: {voltage} V)", CYLINDER,
                  published=published, simulated=simulated, within=0.02, unit="N/m")
        for gap, count, published, simulated, voltage in of_gaps
    ]


CHECKS: tuple[Check, ...] = (check_static_lag, check_frequencies, check_electrostatic_pull)
