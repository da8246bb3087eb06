"""Convert a machine's constants to the numbers and units of the pulse loop."""

import functools
import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.machine import setting
from edmsim.machine.components import BOILING_K, Component
from edmsim.machine.machine import Machine, mjcf_version
from edmsim.plant.gap import gas
from edmsim.plant.gap.breakdown import GapLaw
from edmsim.plant.gap.generator import crater_um3, switched_off, timing
from edmsim.plant.gap.water import AMBIENT_PA, Jets, face_Pa, jets, kerf_jets, permittivity_ratio, viscosity_ratio
from edmsim.plant.kernel.state import GRID, NO_METAL_UM, Arrays, Constants, Propagators, Timing
from edmsim.plant.mechanics.full_model import DriveSetup, FullMechanics, TableMechanics
from edmsim.plant.mechanics.modal import fill_table, fill_wire
from edmsim.plant.mechanics.model import ModalModel, WireSetup, build_model, modes_with, screw_constants
from edmsim.plant.mechanics.squeeze_film import added_mass_kg_m, edge_loss_kg_m2, pull_sum_um2
from edmsim.plant.resolution import Resolution
from edmsim.plant.wire import VACUUM_PERMEABILITY_N_A2, VACUUM_PERMITTIVITY_F_M, HeatLaw, area_m2

RAY_RANGE_UM = 110.0  # range of rays (ours: at a gap of 20 um the pull beyond is 2 %)
CARVE_BEFORE_UM, CARVE_BEFORE_SPACINGS = 12.0, 0.75
"""Distance before a ray's edge from which its wall is searched: least value, and value in ray spacings (ours).
Between rays the wall may be nearer, the more the wider their spacing, and metal that is not reached would stay in the
kerf."""
LEAST_ENERGY_J = 1e-9
"""Least energy for the lifetime of a discharge's gas (ours); a generator that is off has an energy of 0."""
LEAST_PARTICLE_UM = 0.05  # least mean size of particles (ours: finer ones do not prime)
JET_REACH_MM = 3.0  # height over which a jet turns into the kerf: half the usual bore of a nozzle (ours)
PRIMED_SPAN = 3.0  # a site can be primed up to this number of widths above the critical gap


def _patch_m2(machine: Machine, res: Resolution) -> float:
    """Return the area of wire surface of one ray."""
    around = math.pi * machine.wire_diameter_um * 1e-6 / res.rays
    return around * machine.height_mm * 1e-3 / res.slices


def gap_law(machine: Machine, res: Resolution, open_V: float) -> GapLaw:
    """Return the breakdown constants of one ray."""
    gap = machine.base.gap
    # front area to which the t50 law refers: half the wire's circumference times the height
    reference_m2 = math.pi / 2 * gap.reference_wire_um.value * 1e-6 * gap.reference_height_mm.value * 1e-3
    share = _patch_m2(machine, res) / reference_m2
    scale = 1.0 / (math.log(2) * share)
    width, field = gap.critical_width_um.value, open_V / gap.reference_voltage_V.value
    primed_per_um2 = share / (4 * PRIMED_SPAN * (width * field) ** 2)
    size_um = max(gap.particle_share.value * crater_um3(machine) ** (1 / 3), LEAST_PARTICLE_UM)
    particles_um3 = _patch_m2(machine, res) * 1e12 / (math.pi * size_um**3)
    burns = open_V > machine.material.burning_voltage_V.value  # a generator that is off ignites nothing
    return GapLaw(
        t50_a=gap.median_a_us_um2.value * scale,
        t50_b=gap.median_b_us_um.value * scale,
        t50_c=gap.median_c_us.value * scale,
        gap_scale=gap.reference_voltage_V.value / open_V,
        scaled_gap_floor_um=-gap.median_b_us_um.value / (2 * gap.median_a_us_um2.value),
        primed_gap_um=(gap.critical_um.value + PRIMED_SPAN * width) * field,
        primed_per_um2=primed_per_um2,
        particle_gap_um=gap.critical_um.value * field,
        particle_um=size_um,
        particles_um=particles_um3 / primed_per_um2 if burns else 0.0,
        contact_gap_um=gap.contact_um.value,
        wire_curvature=2.0 / machine.wire_diameter_um,
    )


def _gap_viscosity_Pa_s(machine: Machine) -> float:
    """Return the viscosity of the gap's water without debris."""
    water = machine.base.dielectric
    return water.viscosity_Pa_s.value * viscosity_ratio(water.gap_temperature_K.value)


def _wake_jets(machine: Machine) -> Jets:
    """Return the flow of the two nozzles through the kerf behind the wire."""
    return kerf_jets(*faces_Pa(machine), _kerf_um(machine), machine.height_mm)


def _kerf_um(machine: Machine) -> float:
    return machine.wire_diameter_um + 2 * machine.base.dielectric.side_gap_um.value


def _same_names(component: Component) -> dict[str, Any]:
    """Return the constants of a component that the loop uses unchanged, by the same names."""
    return {name: constant.value for name, constant in component if name in Constants._fields}


def constants(machine: Machine, res: Resolution) -> Constants:
    """Return the loop's constants that do not depend on the generator's setting."""
    base, water, spark = machine.base, machine.base.dielectric, machine.base.discharge
    radius = machine.wire_diameter_um / 2
    slice_um = machine.height_mm * 1e3 / res.slices
    slice_m = slice_um * 1e-6
    patch = _patch_m2(machine, res)
    front, side = res.film_from_um, max(res.film_from_um, water.side_gap_um.value)
    flow, wake, bends = flushing(machine), _wake_jets(machine), setting.guide_bends(machine)
    return Constants(
        # separate arguments, so a name in two of them is an error
        **_same_names(base.gap), **_same_names(spark), **_same_names(base.gas), **_same_names(base.cooling),
        **_same_names(base.table), **_same_names(machine.wire),
        radius_um=radius,
        slice_um=slice_um,
        cell_um=res.cell_um,
        range_um=RAY_RANGE_UM,
        trace_pulses=res.trace_windows * setting.WINDOW_PULSES,
        carve_before_um=max(CARVE_BEFORE_UM, CARVE_BEFORE_SPACINGS * 2 * math.pi * radius / res.rays),
        patch_m2=patch,
        permittivity_F_m=water.permittivity.value
        * permittivity_ratio(water.gap_temperature_K.value)
        * VACUUM_PERMITTIVITY_F_M,
        leak_S_um=water.conductivity_uS_cm.value * 1e-4 * patch * 1e6,
        supply_ohm=setting.resistance_ohm(machine),
        crater_cube=6.0 / (math.pi * spark.crater_flatness.value),
        film_um3_kg_s=water.film_stirring.value
        * 12 * _gap_viscosity_Pa_s(machine) * radius**3 * 2 * math.pi / res.rays * slice_m,
        film_from_um=front,
        film_spans=res.film_spans,
        film_pull_um2=pull_sum_um2(radius, front, side, res.rays),
        jet_kg_um=1e-6
        * edge_loss_kg_m2(radius, water.side_gap_um.value, water.edge_loss.value)
        * slice_m,
        suction_N=AMBIENT_PA * machine.wire_diameter_um * 1e-6 * slice_m,
        magnetic_N_A2=machine.material.magnetic_share.value
        * VACUUM_PERMEABILITY_N_A2 / (2 * _kerf_um(machine) * 1e-6) * slice_m,
        lower_flow_us=flow.lower_m_s / slice_m * 1e-6,
        upper_flow_us=flow.upper_m_s / slice_m * 1e-6,
        lower_wake_us=wake.lower_m_s / slice_m * 1e-6,
        upper_wake_us=wake.upper_m_s / slice_m * 1e-6,
        cavity_um3=math.pi * radius * slice_um * water.side_gap_um.value,
        wake_um3=_kerf_um(machine) * water.wake_mm.value * 1e3 * slice_um,
        gas_um3_J=base.gas.permanent_share.value / AMBIENT_PA * 1e18,
        tension_N=machine.tension,
        strength_N=machine.breaking_force,
        water_K=water.temperature_K.value,
        worn_share_per_um3_us=spark.wear_ratio.value
        / (setting.wire_speed_m_s(machine) * math.pi * radius**2),
        guides_um=machine.guide_distance_mm * 1e3,
        lower_bend_um=1e3 * (bends.stiff_mm + bends.lower_error_mm),
        upper_bend_um=1e3 * (bends.stiff_mm - bends.upper_error_mm),
        guide_radius_um=1e3 * bends.radius_mm,
    )


def heat_law(machine: Machine, res: Resolution) -> HeatLaw:
    """Return the heat balance of the wire in one slice."""
    wire, cooling = machine.wire, machine.base.cooling
    section = area_m2(machine.wire_diameter_um)
    slice_m = machine.height_mm * 1e-3 / res.slices
    volumetric = wire.density_kg_m3.value * wire.heat_capacity_J_kgK.value
    girth = math.pi * machine.wire_diameter_um * 1e-6
    joule_W_m_per_A2 = wire.resistivity_Ohm_m.value / section
    return HeatLaw(
        kelvin_per_J=1 / (volumetric * section * slice_m),
        cooling_m2K_J=girth / (volumetric * section) * 1e-6,
        conduction_per_us=wire.conductivity_W_mK.value / volumetric / slice_m**2 * 1e-6,
        run_per_us=setting.wire_speed_m_s(machine) / slice_m * 1e-6,
        joule_K_per_A2_us=joule_W_m_per_A2 / (volumetric * section) * 1e-6,
        resistance_per_K=wire.resistivity_per_K.value,
        water_K=machine.base.dielectric.temperature_K.value,
        boiling_K=BOILING_K,
        superheat_K=cooling.superheat_K.value,
        film_W_m2K=cooling.film_W_m2K.value,
        dry_share=cooling.dry_share.value,
        melting_K=wire.melting_K.value,
        spot_K_m_J=1 / (volumetric * section),
        spot_m2=(machine.wire_diameter_um * 1e-6) ** 2,
        spreading_m2_us=math.pi * wire.conductivity_W_mK.value / volumetric * 1e-6,
    )


def strong_discharge(*machines: Machine) -> str:
    """Return a sentence about the strongest discharge that can break the wire of its machine; empty if none can."""
    strong_mJ = max(map(_too_strong_mJ, machines))
    if not strong_mJ:
        return ""
    return (f"a discharge of {strong_mJ:.3g} mJ, followed by an arc, can break this wire at any period; choose a "
            "lower peak current, a shorter on-time or a thicker wire")  # fmt: skip


def _too_strong_mJ(machine: Machine) -> float:
    """Return the energy of one discharge and one arc if it breaks a wire at the boiling point; otherwise 0."""
    heat, pulse = heat_law(machine, Resolution(1, 1, 1)), timing(machine)
    energy_J = pulse.burning_V * pulse.current_A * pulse.on_us * 1e-6
    heat_J = machine.base.cooling.wire_heat_share.value * energy_J * (1 + pulse.arc_share)
    hot_K = BOILING_K + heat_J * heat.spot_K_m_J / math.sqrt(heat.spot_m2)
    share = 1 - 0.5 * (hot_K - heat.water_K) / (machine.wire.half_strength_K.value - heat.water_K)
    return 1e3 * energy_J if share * machine.breaking_force < machine.tension else 0.0


def gas_law(machine: Machine, timing: Timing) -> gas.GasLaw:
    """Return the gas constants of one setting; the lifetime is that of the gas of its longest discharges."""
    law, water, kerf = machine.base.gas, machine.base.dielectric, _kerf_um(machine)
    shares = law.steam_share.value, law.permanent_share.value
    steam, permanent = (math.sqrt(gas.cover_um2_J(share, kerf)) for share in shares)
    energy_J = max(timing.burning_V * timing.current_A * timing.on_us * 1e-6, LEAST_ENERGY_J)
    life_us = gas.steam_life_us(steam * math.sqrt(energy_J), law.steam_periods.value)
    filled_us = gas.refill_us(
        math.pi / 4 * machine.wire_diameter_um, gas.REFERENCE_GAP_UM, _gap_viscosity_Pa_s(machine),
        water.gap_temperature_K.value, law.wetting.value,
    )  # fmt: skip
    fading = np.empty((GRID + 1, 2))
    gas.fill_fading(fading, max(life_us, 1.0), max(filled_us, 1.0), timing.grid_us)
    return gas.GasLaw(steam, permanent, gas.refill_um_s(water.side_gap_um.value, life_us), fading)


def push_law(machine: Machine) -> gas.BubbleLaw:
    """Return the constants of the push of bubbles on this wire."""
    spark = machine.base.discharge
    return gas.bubble_law(machine.wire_diameter_um, spark.impulse_10mJ_Ns.value, spark.bubble_share.value)


def wire_setup(machine: Machine) -> WireSetup:
    """Return the wire, guides and water in the slot for the model of the mechanics."""
    return WireSetup(
        diameter_m=machine.wire_diameter_um / 1e6,  # rounded, so 20 um is exactly 20e-6
        density_kg_m3=machine.wire.density_kg_m3.value,
        tension=machine.tension,
        guide_distance_m=machine.guide_distance_mm * 1e-3,
        damping_ratio=machine.base.guides.damping_ratio.value,
        slot_m=machine.height_mm * 1e-3,
        slot_mass_kg_m=added_mass_kg_m(
            machine.wire_diameter_um / 2, gas.REFERENCE_GAP_UM, machine.base.dielectric.side_gap_um.value
        ),
    )


def _slice_heights_m(machine: Machine, res: Resolution) -> NDArray[np.float64]:
    """Return the heights of the slices' mid-planes above the lower guide."""
    middle = (np.arange(res.slices) + 0.5) / res.slices * machine.height_mm
    return (middle + machine.base.guides.clearance_mm.value) * 1e-3


def modal_model(machine: Machine, res: Resolution) -> ModalModel:
    """Return the modes of table and wire for this set-up, from the MJCF."""
    heights = tuple(_slice_heights_m(machine, res).tolist())
    return modes_with(wire_setup(machine), machine.base.model, res.modes, heights)


def screws(machine: Machine) -> dict[int, dict[str, float]]:
    """Return the constants of `MOTOR` that belong to the machine, for its axes x (0) and y (1)."""
    table, file = machine.base.table, machine.base.model
    friction_N, backlash_um = table.friction_N.value, table.backlash_um.value
    dry = {"way_friction_N": friction_N, "way_stiction_N": friction_N, "backlash_um": backlash_um}
    return {k: {**dry, **screw} for k, screw in enumerate(_screws(wire_setup(machine), file, mjcf_version(file)))}


@functools.lru_cache(maxsize=64)
def _screws(wire: WireSetup, model_file: str, _version: int) -> tuple[dict[str, float], ...]:
    return screw_constants(build_model(wire, model_file))


def _drive_setup(machine: Machine) -> DriveSetup:
    table = machine.base.table
    return DriveSetup(
        step_m=table.step_um.value * 1e-6,
        friction_N=table.friction_N.value,
        presliding_m=table.presliding_um.value * 1e-6,
        backlash_m=table.backlash_um.value * 1e-6,
    )


def full_mechanics(machine: Machine, res: Resolution) -> FullMechanics:
    """Return the MuJoCo model of this set-up for the loop."""
    heights = _slice_heights_m(machine, res)
    full = FullMechanics(
        wire_setup(machine), _drive_setup(machine), heights, machine.base.model, varied=timing(machine).period_ns == 0
    )
    full.set_travel(machine.base.table.travel_mm.value * 1e-3)
    return full


def table_mechanics(machine: Machine, longest_us: float) -> TableMechanics:
    """Return the MuJoCo model of this machine's table without the wire, with a longest time step."""
    table = TableMechanics(_drive_setup(machine), longest_us, machine.base.model)
    table.set_travel(machine.base.table.travel_mm.value * 1e-3)
    return table


def fill_propagators(p: Propagators, modes: ModalModel, timing: Timing) -> None:
    """Fill a plant's tables of exact propagators for the setting's time grid."""
    dt = timing.grid_us * 1e-6
    fill_wire(p.wire, p.yielding, p.wire_compliance, modes.wire_omega, modes.wire_zeta, modes.wire_shape, dt)
    fill_table(p.table11, p.table12, p.table21, p.table22, modes.table_omega, modes.table_zeta, dt)


def flushing(machine: Machine) -> Jets:
    """Return the flow of the two nozzles through the gap."""
    water = machine.base.dielectric
    return jets(*faces_Pa(machine), _gap_viscosity_Pa_s(machine), water.side_gap_um.value, machine.height_mm)


def faces_Pa(machine: Machine) -> tuple[float, float]:
    """Return the flushing pressures at the workpiece's lower and upper face, after the losses of the stand-offs."""
    water, set_Pa, standoff_mm = machine.base.dielectric, setting.flushing_Pa(machine), setting.standoffs_mm(machine)
    lower, upper = (
        face_Pa(pressure, distance, water.nozzle_mm.value, water.nozzle_flow_l_min.value)
        for pressure, distance in zip(set_Pa, standoff_mm, strict=True)
    )
    return lower, upper


def height_share(machine: Machine, res: Resolution) -> NDArray[np.float64]:
    """Return the heights of the slices' mid-planes above the lower guide, as shares of the guides' distance."""
    return _slice_heights_m(machine, res) / (machine.guide_distance_mm * 1e-3)


def flow_m_s(machine: Machine, res: Resolution) -> NDArray[np.float64]:
    """Return the speed of the water past every slice."""
    return flushing(machine).past_m_s((np.arange(res.slices) + 0.5) / res.slices)


def wake_m_s(machine: Machine, res: Resolution) -> NDArray[np.float64]:
    """Return the speed of the water behind every slice: that of the flow, 0 where jets meet, and that of eddies."""
    wake = _wake_jets(machine)
    down = wake.past_m_s((np.arange(res.slices) + 0.5) / res.slices)
    return np.hypot(down, machine.base.dielectric.turbulence.value * max(wake.lower_m_s, wake.upper_m_s))


def convection_W_m2K(machine: Machine, res: Resolution) -> NDArray[np.float64]:
    """Return the heat transfer coefficient of every slice without boiling, ``h (1 + k v)``, at front and back."""
    cooling, past_m_s = machine.base.cooling, 0.5 * (flow_m_s(machine, res) + wake_m_s(machine, res))
    return cooling.convection_W_m2K.value * (1 + cooling.convection_per_m_s.value * past_m_s)


def critical_W_m2(machine: Machine, res: Resolution) -> NDArray[np.float64]:
    """Return the critical heat flux of every slice: that of a pool, or more in a flow, ``k sqrt(v) (T_b - T_w)``."""
    cooling, subcooling_K = machine.base.cooling, BOILING_K - machine.base.dielectric.temperature_K.value
    stream = cooling.critical_stream.value * np.sqrt(wake_m_s(machine, res)) * subcooling_K
    return np.maximum(cooling.critical_W_m2.value, stream)


def jet_um_kg_s2(machine: Machine, res: Resolution) -> NDArray[np.float64]:
    """Return the force on every slice of jets that turn into the kerf: ``c d dp exp(-z / l)`` per length and face."""
    edges_mm = np.arange(res.slices + 1) / res.slices * machine.height_mm
    force = np.zeros(res.slices)
    for pressure_Pa, from_face_mm in zip(faces_Pa(machine), (edges_mm, edges_mm[::-1]), strict=True):
        left = np.exp(-from_face_mm / JET_REACH_MM)
        force += pressure_Pa * np.abs(np.diff(left)) * JET_REACH_MM * 1e-3
    return machine.base.dielectric.jet_drag.value * machine.wire_diameter_um * force


def fill_arrays(a: Arrays, model: ModalModel | FullMechanics, machine: Machine, res: Resolution) -> None:
    """Fill the arrays that belong to the set-up."""
    fill_model(a, model)
    a.height_share[: res.slices] = height_share(machine, res)
    a.carried_per_us[:] = flow_m_s(machine, res) / machine.base.gap.carried_um.value
    a.convection_W_m2K[:] = convection_W_m2K(machine, res)
    a.critical_W_m2[:] = critical_W_m2(machine, res)
    a.jet_um_kg_s2[:] = jet_um_kg_s2(machine, res)
    a.flow_share[:] = flushing(machine).flow_share(res.slices)


def fill_model(a: Arrays, model: ModalModel | FullMechanics) -> None:
    """Fill the rays' directions and the wire of the model, whose shape is (slices, modes or nodes)."""
    slices, modes = model.wire_shape.shape
    angle = 2 * np.pi * np.arange(len(a.ray_cosine)) / len(a.ray_cosine)
    a.ray_cosine[:], a.ray_sine[:] = np.cos(angle), np.sin(angle)
    a.shape[:, :modes] = model.wire_shape
    a.sway[:, :slices] = a.shape.T
    a.mean_shape[:] = a.shape.mean(axis=0)
    a.slice_mass_kg[:] = model.slice_mass_kg
    a.mobility[:modes], a.inertia[:modes] = model.mobility, model.inertia
    a.table_shape[:] = model.table_slide_shape
    a.table_participation[:] = model.table_participation


def set_vertical(a: Arrays) -> None:
    """Set the rays to those of a vertical wire."""
    a.reach_x[:] = a.across_x[:] = a.ray_cosine
    a.reach_y[:] = a.across_y[:] = a.ray_sine
    a.upright[:], a.lean_share[:] = 1.0, a.height_share


def reset_arrays(a: Arrays, names: Iterable[str], water_K: float) -> None:
    """Set arrays of a plant to their values at rest."""
    others = {
        "reference_um": -1e9,  # far away, so all rays are first traced in full
        "distance": NO_METAL_UM,
        "temperature_K": water_K,
        "ray_metal": 1.0,
        "metal": 1.0,
    }
    for name in names:
        getattr(a, name).fill(others.get(name, 0))


class GeneratorSetting(NamedTuple):
    """Times and currents of a setting, its constants of breakdown and gas, its machine, and whether it is on."""

    timing: Timing
    gap: GapLaw
    gas: gas.GasLaw
    machine: Machine
    on: bool


def settings_of(machine: Machine, resolution: Resolution) -> Callable[[float, float, bool], GeneratorSetting]:
    """Return a function that makes a setting from on-time, period and on or off; it raises `InputError`."""

    @functools.lru_cache(128)  # some 10 kB each; controllers return to the same settings
    def made(t_on_us: float, t_period_us: float, on: bool) -> GeneratorSetting:
        same = (t_on_us, t_period_us) == (machine.t_on_us, machine.t_period_us)
        with_it = machine if same else machine.with_pulses(t_on_us, t_period_us)
        times = timing(with_it) if on else switched_off(timing(with_it))
        law = gap_law(with_it, resolution, times.open_V)
        return GeneratorSetting(times, law, gas_law(with_it, times), with_it, on)

    return made
