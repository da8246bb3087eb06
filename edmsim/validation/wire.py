"""The wire: closed forms of a string between guides, the electrostatic pull, and the heat balance."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from edmsim import models
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.plant.constants import RAY_RANGE_UM, gap_law, heat_law, height_share, modal_model, wire_setup
from edmsim.plant.gap.breakdown import slice_sums
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.kernel import discharge, state
from edmsim.plant.mechanics.model import build_model, reduce_model
from edmsim.plant.resolution import resolution
from edmsim.plant.wire import VACUUM_PERMITTIVITY_F_M, HeatLaw, add_currents, area_m2, heat_step, heat_transfer_W_m2K
from edmsim.validation.rows import Checks, Row, Seeds, worst
from edmsim.validation.setups import altered

STRING = "taut string under a uniform load, closed form"
WAVE = "taut string, f = n / (2 L) sqrt(T / mu)"
CYLINDER = "cylinder before a plane, closed form"

FREQUENCIES_HZ = ((40.0, 1935.0), (80.0, 968.0), (150.0, 516.0))
"""First frequency of 0.25 mm brass of 8500 kg/m3 at 10 N, by the distance of the guides in mm."""


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
    """Return the deflection at mid-height under 1 N/m over the workpiece, by the pulse loop's modes and slices."""
    machine = Machine.load(height_mm=height_mm, tension=tension)
    modes = modal_model(machine, resolution("default"))
    slices = len(modes.wire_shape)
    load = np.full(slices, height_mm * 1e-3 / slices)
    return float(modes.wire_shape[slices // 2] @ (modes.wire_shape.T @ load / modes.wire_omega**2)) * 1e6


def check_static_lag(seeds: Seeds) -> list[Row]:
    """Compare all 25 rows of the table; the worst tension of every height is shown."""
    of_heights = _worst_rows("analytic_static_wire_lag", "h_mm", "T_N", "ymax_um_per_N_per_m", static_lag_um)
    return [
        Row.value("wire", f"static lag at 1 N/m, {height:g} mm high (worst of {count} tensions: {tension} N)", STRING,
                  published=published, simulated=simulated, within=0.01, unit="um")
        for height, count, published, simulated, tension in of_heights
    ]


def frequencies_Hz(guide_distance_mm: float) -> list[float]:
    """Return the first four frequencies of the published example's wire in air."""
    clearance_mm = Machine.load().base.guides.clearance_mm.value
    machine = Machine.load(height_mm=guide_distance_mm - 2 * clearance_mm, tension=10.0)
    in_slot = wire_setup(altered(machine, {"wire.density_kg_m3": 8500.0}))
    model = build_model(replace(in_slot, slot_mass_kg_m=0.0), machine.base.model)
    modes = reduce_model(model, 4, [guide_distance_mm * 0.5e-3])
    return [float(omega) / math.tau for omega in modes.wire_omega]


def check_frequencies(seeds: Seeds) -> list[Row]:
    """Compare the first frequency at three guide distances, and overtones at the first."""
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
    """Return the pull per metre on the default wire at a flat wall, summed over rays as in the pulse loop."""
    machine, res = Machine.load(), resolution("default")
    radius = machine.wire_diameter_um / 2
    angle = 2 * math.pi * np.arange(res.rays) / res.rays
    angle = angle[np.cos(angle) > (radius + gap_um) / (radius + RAY_RANGE_UM)]  # range of rays
    gaps = (radius + gap_um) / np.cos(angle) - radius
    sums = np.zeros((1, 4))
    slice_sums(rays_with(gaps, angle), 0, 0.0, 0.0, gap_law(machine, res, voltage_V), sums)
    inverse_square_um2 = float(sums[0, 2])
    girth_per_ray_m = math.pi * machine.wire_diameter_um * 1e-6 / res.rays
    permittivity_F_m = machine.base.dielectric.permittivity.value * VACUUM_PERMITTIVITY_F_M  # at 20 C, as published
    return permittivity_F_m / 2 * voltage_V**2 * inverse_square_um2 * 1e12 * girth_per_ray_m


def check_electrostatic_pull(seeds: Seeds) -> list[Row]:
    """Compare all 25 rows of the table; the worst voltage at every gap is shown."""
    of_gaps = _worst_rows("analytic_electrostatic_force", "gap_um", "V", "force_N_per_m", pull_N_m)
    return [
        Row.value("wire", f"electrostatic pull at {gap:g} um (worst of {count} voltages: {voltage} V)", CYLINDER,
                  published=published, simulated=simulated, within=0.02, unit="N/m")
        for gap, count, published, simulated, voltage in of_gaps
    ]


# Heat.

SCHACHT = "Schacht, KU Leuven 2004: Joule heat of a quarter of the wire's resistance against convection"
SATO = "Sato et al., J. Japan Soc. Electrical Machining Engineers (2013): 60 kHz, 9.8 mJ; balance in closed form"

DIVIDED = "current from contacts at both guides, divided as the wire's resistances (closed form)"
BOILING = "boiling curve: cubic nucleate branch up to the critical heat flux (Rohsenow; closed form of the model)"

STEP_US = 100.0
SETTLE_S = 0.5  # more than 20 time constants of the thickest wire


def _wire(machine: Machine, law: HeatLaw) -> state.Arrays:
    """Return slices of a wire at the water's temperature, in still water."""
    res = resolution("default")
    a = state.allocate(state.Arrays, state.sizes_of(res.slices, res.rays, res.modes))
    a.temperature_K[:] = law.water_K
    a.convection_W_m2K[:] = machine.base.cooling.convection_W_m2K.value
    a.critical_W_m2[:] = machine.base.cooling.critical_W_m2.value
    return a


def _currents(a: state.Arrays) -> Floats:
    """Return the integrals of the squared current in the slices' wire, in A2 us."""
    found = np.empty(len(a.temperature_K))
    add_currents(a, found)
    return found


def _settled_rise_K(machine: Machine, law: HeatLaw, spark_W: float = 0.0, current_A: float = 0.0) -> float:
    """Return the mean rise over the height after a steady power of sparks and a current through the whole wire."""
    a = _wire(machine, law)
    per_step = spark_W / len(a.temperature_K) * STEP_US * 1e-6 * law.kelvin_per_J
    for _ in range(round(SETTLE_S / (STEP_US * 1e-6))):
        a.temperature_K[:] += per_step
        a.current2_us[:] = 0.0
        a.current2_us[0, -1] = a.current2_us[1, 0] = current_A**2 * STEP_US
        heat_step(a, law, _currents(a), STEP_US)
    return float(a.temperature_K[1:-1].mean()) - law.water_K  # half of this current bypasses the outermost slices


def check_joule_heat(seeds: Seeds) -> list[Row]:
    """Compare the rise at a steady current of 30 A, fed half from each end, with Schacht's heat balance."""
    machine = Machine.load()
    law = heat_law(machine, resolution("default"))._replace(run_per_us=0.0, conduction_per_us=0.0)
    current = 30.0
    wire, convection = machine.wire, machine.base.cooling.convection_W_m2K.value
    joule_W_m = current**2 * wire.resistivity_Ohm_m.value / area_m2(machine.wire_diameter_um) / 4
    cold = joule_W_m / (convection * math.pi * machine.wire_diameter_um * 1e-6)
    return [Row.value(
        "wire", f"Joule heating at {current:g} A, 0.25 mm brass", SCHACHT,
        published=cold / (1 - wire.resistivity_per_K.value * cold),
        simulated=_settled_rise_K(machine, law, current_A=current / math.sqrt(8)), within=0.02, unit="K",
    )]


def joule_share(height_mm: float) -> float:
    """Return the mean square of the current in the wire over that of the discharges, at random heights."""
    machine, res = Machine.load(height_mm=height_mm), resolution("default")
    a = _wire(machine, heat_law(machine, res))
    a.height_share[:res.slices] = height_share(machine, res)
    for s in range(res.slices):
        discharge.divide_current(a, s, 1 / res.slices)
    return float(_currents(a).mean())


def check_joule_shares(seeds: Seeds) -> list[Row]:
    """Compare the mean square of a current fed from both guides, over heights and discharges: 1/6 if no clearance."""
    rows = []
    for height in (20.0, 80.0):
        guides_mm = Machine.load(height_mm=height).guide_distance_mm
        high, aside = height / guides_mm, (1 - height / guides_mm) / 2
        fourth = ((1 - aside) ** 4 - aside**4) / 4
        rows.append(Row.value(
            "wire", f"mean square of the current in the wire, {height:g} of {guides_mm:g} mm", DIVIDED,
            published=2 / (3 * high**2) * (fourth - aside**3 * high), simulated=joule_share(height), within=0.02,
        ))
    return rows


def check_boiling(seeds: Seeds) -> list[Row]:
    """Compare the boiling curve: its cubic branch, its critical flux, and the steady states of a wire."""
    machine = Machine.load(wire="brass-300", height_mm=80.0, tension=22.0)
    res, cooling = resolution("default"), machine.base.cooling
    law = heat_law(machine, res)._replace(run_per_us=0.0)
    convection, critical = cooling.convection_W_m2K.value, cooling.critical_W_m2.value

    def boiling(superheat_K: float) -> float:
        kelvin = law.boiling_K + superheat_K
        return (heat_transfer_W_m2K(kelvin, law, convection, critical, 0.0) - convection) * (kelvin - law.water_K)

    surface_m2 = math.pi * machine.wire_diameter_um * 1e-6 * machine.height_mm * 1e-3
    power_W = 0.75 * critical * surface_m2
    most = critical - convection * (law.boiling_K + law.superheat_K - law.water_K)

    def excess(superheat_K: float) -> float:
        flux = convection * (law.boiling_K + superheat_K - law.water_K) + most * (superheat_K / law.superheat_K) ** 3
        return flux - 0.75 * critical

    nearly = (1 - 1e-9) * law.superheat_K
    return [
        Row.value("wire", "heat flux by boiling, half of the critical superheat over all of it", BOILING,
                  published=1 / 8, simulated=boiling(law.superheat_K / 2) / boiling(nearly), within=0.01),
        Row.value("wire", "largest heat flux before a film of steam", BOILING, published=critical * 1e-6,
                  simulated=1e-6 * heat_transfer_W_m2K(law.boiling_K + nearly, law, convection, critical, 0.0)
                  * (law.boiling_K + nearly - law.water_K), within=0.01, unit="MW/m2"),
        Row.value("wire", "mean rise at three quarters of the critical heat flux", BOILING,
                  published=law.boiling_K - law.water_K + float(brentq(excess, 0.0, law.superheat_K)),
                  simulated=_settled_rise_K(machine, law, spark_W=power_W), within=0.02, unit="K"),
    ]


def check_cooling(seeds: Seeds) -> list[Row]:
    """Compare the time constant of cooling in water: ``rho c d / (4 h)``."""
    machine = Machine.load()
    law = heat_law(machine, resolution("default"))._replace(run_per_us=0.0)
    a = _wire(machine, law)
    a.temperature_K[:] = law.water_K + 70.0  # below boiling
    steps = 100
    for _ in range(steps):
        heat_step(a, law, _currents(a), STEP_US)
    constant_s = steps * STEP_US * 1e-6 / math.log(70.0 / float(a.temperature_K.mean() - law.water_K))
    wire = machine.wire
    expected_s = (
        wire.density_kg_m3.value * wire.heat_capacity_J_kgK.value * machine.wire_diameter_um * 1e-6
        / (4 * machine.base.cooling.convection_W_m2K.value)
    )
    return [Row.value(
        "wire", "time constant of cooling, 0.25 mm brass", "rho c d / (4 h), closed form",
        published=expected_s * 1e3, simulated=constant_s * 1e3, within=0.01, unit="ms",
    )]


def check_spark_heat(seeds: Seeds) -> list[Row]:
    """Compare the mean rise of the 0.3 mm wire at 590 W over 80 mm, a tenth of it into the wire, without boiling."""
    machine = Machine.load(wire="brass-300", height_mm=80.0, tension=22.0)
    law = heat_law(machine, resolution("default"))
    return [Row.value(
        "wire", "mean rise at 590 W over 80 mm, 0.1 of it into the wire", SATO, published=56.0,
        simulated=_settled_rise_K(machine, law, spark_W=0.1 * 590.0), within=0.05, unit="K",
    )]


CHECKS: Checks = dict.fromkeys((
    check_static_lag, check_frequencies, check_electrostatic_pull,
    check_joule_heat, check_joule_shares, check_cooling, check_spark_heat, check_boiling,
), ("wire",))
