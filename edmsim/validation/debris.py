"""Rows on debris in the gap: gap width over pulse energy, delays in debris, particle sizes."""

import math
from itertools import pairwise

import numpy as np

from edmsim.controllers import from_text
from edmsim.cosim.straight import Cut, Traverse, begin
from edmsim.evaluation.stable_rate import quick_counts
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.plant.gap.generator import crater_um3
from edmsim.plant.window import PlantError
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM
from edmsim.validation import ignition
from edmsim.validation.breakage import ROUGH_PERIOD_US, rough_rig
from edmsim.validation.rows import Checks, Row, Seeds, differences
from edmsim.validation.setups import NO_IGNITION, PRACTICE, STILL, UNBREAKABLE, altered, in_a_hole, servo_cut

WIDER = (
    f"{PRACTICE}: more energy per pulse, a wider gap at one voltage; {ignition.ESTEVES}: energy influences the delay"
)
REMAINS = f"{ignition.THESIS}: the flow carries the remains of discharges off, and the delays rise"
GAPS = "docs/theory/emergence.md#kerf-and-gaps"
PARTICLES = "docs/theory/breakdown.md#particles"

OPEN_SHARE = 0.2  # share of open pulses that the servo of these cuts holds (ours: far from a jam of the rough cut)


# --- the gap over the energy of the pulses ---

ROUGH_MM = 30.0
BRIEF_US, LONG_US = 0.4, 1.4
"""On-times at one current and pause: the longer pulse has 3.5 times the energy (ours)."""


def gap_over_energy(seeds: Seeds) -> list[Row]:
    """Compare the gap at discharges of short and long pulses with the same peak."""
    brief, long = (
        [servo_cut(rough_pulses(on), seed, open_share=OPEN_SHARE) for seed in seeds] for on in (BRIEF_US, LONG_US)
    )
    return [Row.sign("kerf", f"gap at the discharges of a rough cut, on-time {BRIEF_US:g} to {LONG_US:g} us", WIDER,
                     rises=True, simulated=differences(brief, long, lambda cut: cut.gap_um), unit="um", note=GAPS)]


def rough_pulses(t_on_us: float) -> Machine:
    """Return the rough cut with another on-time, the same peak and the same pause."""
    rough = rough_rig(ROUGH_MM)
    return rough.with_(t_on_us=t_on_us, t_period_us=t_on_us + rough.t_period_us - rough.t_on_us)


FINE_MJ, FINE_ON_US = 0.05, 0.2
COARSE_MJ, COARSE_ON_US = 10.0, 1.4  # a pulse of fine cuts and one of rough cuts, triangles both (ours: usual orders)
SIDE_MM, SIDE_V, SIDE_PA = 5.0, 80.0, 0.2e5
"""For both: height (ours: fine pulses cut slowly), open voltage, the nominal one of the ignition law, and pressure of
the nozzles (ours: that of trims and sheet)."""
START_GAP_UM = 10.0
"""Gap of the initial slot (ours: narrower than that of fine pulses, so the slot is not measured)."""
SETTLED_UM, KERF_UM, LONGEST_S = 40.0, 20.0, 600.0
"""Travel until the kerf is determined by the pulses, measured length of kerf, and greatest machine time (ours)."""
FEW = 3  # seeds of these slots (ours: a slot takes five million fine pulses)


def side_gap_over_energy(seeds: Seeds) -> list[Row]:
    """Compare the side gap of slots cut with fine pulses and with those of a rough cut."""
    fine, coarse = (
        [side_gap_um(slot_rig(energy, on), seed) for seed in seeds[:FEW]]
        for energy, on in ((FINE_MJ, FINE_ON_US), (COARSE_MJ, COARSE_ON_US))
    )
    return [Row.sign("kerf", f"side gap, {FINE_MJ:g} to {COARSE_MJ:g} mJ per discharge at {SIDE_V:g} V", WIDER,
                     rises=True, simulated=differences(fine, coarse), unit="um", note=GAPS)]


def slot_rig(energy_mJ: float, t_on_us: float) -> Machine:
    """Return a production machine with triangles of an energy and a duration, and the pause of rough cuts."""
    burning_V = Machine.load().material.burning_voltage_V.value
    machine = Machine.load(
        "production", generator="production", height_mm=SIDE_MM, open_voltage_V=SIDE_V, t_on_us=t_on_us,
        t_period_us=t_on_us + ROUGH_PERIOD_US - COARSE_ON_US, flushing_lower_Pa=SIDE_PA, flushing_upper_Pa=SIDE_PA,
        peak_current_A=2 * energy_mJ * 1e3 / (burning_V * t_on_us),
    )
    return altered(machine, UNBREAKABLE)


def side_gap_um(machine: Machine, seed: int) -> float:
    """Cut a slot; return half of the kerf minus the wire, NaN if it jams or takes longer than `LONGEST_S`."""
    plant = begin(machine, seed, gap_um=START_GAP_UM)
    traverse = Traverse(plant, from_text(quick_counts(OPEN_SHARE)))

    def run_to(x_um: float) -> list[PulseWindow]:
        windows = []
        while plant.commanded_um[0] < x_um and plant.time_ns < LONGEST_S * 1e9:
            windows.append(traverse.window())
        return windows

    try:
        run_to(plant.commanded_um[0] + SETTLED_UM)
        from_um = plant.commanded_um[0]
        windows = run_to(from_um + machine.wire_diameter_um / 2 + SLOT_GAP_UM + KERF_UM)
    except PlantError:
        return math.nan
    if plant.time_ns >= LONGEST_S * 1e9:
        return math.nan
    cut = Cut(plant, windows, from_um, plant.commanded_um[0] - from_um)
    return (float(cut.kerf_um.mean()) - machine.wire_diameter_um) / 2


# --- delays in debris ---

SPEEDS_M_S = (0.0, 1.0, 2.0)  # mean flow speeds of figure 2-9
HOLE_UM, HOLE_V = 25.0, 80.0
"""Gap and open voltage, the nominal one of the ignition law (ours: at the figure's 300 V all its gaps would be below
the critical one by equal fields, with or without debris)."""
SPARK_A = 1.2  # energy of discharges (ours, not published: craters so small that the hole keeps its gap to 1 um)
HOLES, BEFORE, MEASURED = 6, 1, 1
"""Holes per seed, windows of 25 ms until the debris in flowing water is steady, and measured windows."""


def delay_in_debris(seeds: Seeds) -> list[Row]:
    """Compare the mean delay in the debris of discharges, over the speed of the water that removes it."""
    # craters remove metal here, because only they make debris; all other motion of the water is off
    delay = {
        speed: [
            ignition.mean_delay_us([w for hole in range(HOLES) for w in in_debris(speed, HOLES * seed + hole)])
            for seed in seeds
        ]
        for speed in SPEEDS_M_S
    }
    return [
        Row.sign("ignition", f"mean delay among debris, flow {slow:g} to {quick:g} m/s", REMAINS, rises=True,
                 simulated=differences(delay[slow], delay[quick]), unit="us", note=ignition.FLOW)
        for slow, quick in pairwise(SPEEDS_M_S)
    ]


def in_debris(speed_m_s: float, seed: int) -> list[PulseWindow]:
    """Fire pulses as long as those of figure 2-9 in a hole with their own debris and a flow."""
    usual = Machine.load()
    still, metal = ignition.thesis_machine(speed_m_s, HOLE_V, usual.height_mm), usual.material
    ohm = (still.generator.open_voltage_V.value - metal.burning_voltage_V.value) / SPARK_A
    constants = {"material.removal_mm3_J": metal.removal_mm3_J.value, "generator.resistance_ohm": ohm}
    plant = in_a_hole(altered(still, constants), ignition.hole_gap_um(still, HOLE_UM, seed), seed)
    return [plant.advance() for _ in range(BEFORE + MEASURED)][BEFORE:]


# --- sizes of the particles ---

SIZES = (
    "particles with exponential sizes that hold the volume of the debris, N(> x) = c / (pi d^3) exp(-x / d), ignite "
    "where they leave the critical gap (derived)"
)
NEAR_UM, NEAR_SHARE = 13.0, 1e-6
"""Gap near the critical one, where particles of some mean sizes ignite, and a debris share at which half of the
pulses meet none (ours)."""
FAR_UM, FAR_SHARE = (28.0, 30.0, 32.0), 0.01
"""Gaps of rough cuts, where only the largest particles ignite, and a share at which some pulses meet one (ours)."""
LOADED_WINDOWS = 16  # windows per seed and gap: 4080 pulses


def particles(seeds: Seeds) -> list[Row]:
    """Compare the number of particles that ignite in a hole with debris, and its decrease with the gap."""
    critical_um, size_um = Machine.load().base.gap.critical_um.value, mean_size_um(_at_80_V())
    sizes = (np.array(FAR_UM) - critical_um) / size_um
    over = [[math.log(counted(gap, FAR_SHARE, seed)) for gap in FAR_UM] for seed in seeds]
    return [
        Row.value("ignition", f"number of particles that ignite at {NEAR_UM:g} um over the law's", SIZES,
                  published=1.0, simulated=[counted(NEAR_UM, NEAR_SHARE, seed) for seed in seeds], within=0.1,
                  note=PARTICLES),
        Row.value("ignition", f"fall of that number over {FAR_UM[0]:g} to {FAR_UM[-1]:g} um, e-folds per mean size",
                  SIZES, published=-1.0, within=0.1,
                  simulated=[float(np.polyfit(sizes, of, 1)[0]) - 1 for of in over], note=PARTICLES),
    ]


def counted(gap_um: float, share: float, seed: int) -> float:
    """Return the number of particles that ignite, from the share of pulses that meet none, over the law's number."""
    # the law is summed over the gaps of the rays, with the wire's whole surface as area
    machine, gap = loaded_machine(), Machine.load().base.gap
    plant = in_a_hole(machine, ignition.hole_gap_um(machine, gap_um, seed), seed)
    state = plant.snapshot()
    state["debris"][: plant.resolution.slices] = share
    plant.restore(state)
    windows = [plant.advance() for _ in range(LOADED_WINDOWS)]
    none = max(sum(w.open for w in windows), 1)  # a lower bound if every pulse meets one
    found = -math.log(none / sum(w.pulses for w in windows))
    gaps_um, size_um = ignition.ray_gaps_um(plant), mean_size_um(_at_80_V())
    area_um2 = math.pi * machine.wire_diameter_um * machine.height_mm * 1e3
    per_um3 = share / (math.pi * size_um**3) * np.exp(-(gaps_um - gap.critical_um.value) / size_um)
    return found / (area_um2 * float(np.mean(gaps_um * per_um3)))


def mean_size_um(machine: Machine) -> float:
    """Return the mean particle size of a setting's debris."""
    return float(machine.base.gap.particle_share.value * crater_um3(machine) ** (1 / 3))


def loaded_machine() -> Machine:
    """Return the default machine at the law's nominal voltage, with constant debris of its particle size."""
    usual = _at_80_V()
    still = altered(usual, {**STILL, **ignition.STILL_WATER, **NO_IGNITION})
    return altered(still, {"base.gap.particle_share": mean_size_um(usual) / crater_um3(still) ** (1 / 3)})


def _at_80_V() -> Machine:
    return altered(Machine.load(), {"generator.open_voltage_V": HOLE_V})


CHECKS: Checks = {
    gap_over_energy: ("kerf",), side_gap_over_energy: ("kerf",), delay_in_debris: ("ignition",),
    particles: ("ignition",),
}
