"""Rows on what debris does to the gap: its width over the energy of the pulses, and the delays in debris."""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmsim.controllers import from_text
from edmsim.cosim.straight import Cut, Traverse, begin
from edmsim.evaluation.stable_rate import quick_counts
from edmsim.machine.machine import Machine
from edmsim.plant.window import PlantError, PulseWindow
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM
from edmsim.validation.breakage import ROUGH_PERIOD_US, rough_rig
from edmsim.validation.ignition import ESTEVES, FLOW, THESIS, THESIS_ON_US, hole_gap_um, thesis_machine
from edmsim.validation.rows import Check, Row, mean_and_interval
from edmsim.validation.setups import PRACTICE, UNBREAKABLE, altered, change, in_a_hole, servo_cut

WIDER = f"{PRACTICE}: more energy per pulse, a wider gap at one voltage; {ESTEVES}: energy influences the delay"
REMAINS = f"{THESIS}: the flow carries the remains of discharges off, and the delays rise"
GAPS = "docs/theory/emergence.md#kerf-and-gaps"

OPEN_SHARE = 0.2
"""Share of open pulses that the servo of these cuts holds (ours: a rough cut off its jam)."""


# --- the gap over the energy of the pulses ---

ROUGH_MM = 30.0
BRIEF_US, LONG_US = 0.4, 1.4
"""On-times of one current and one pause: the longer pulse has three and a half times the energy (ours)."""


def gap_over_energy(seeds: Sequence[int]) -> list[Row]:
    """Gap where discharges strike, with brief pulses and with long ones of the same peak."""
    brief, long = (
        [servo_cut(rough_pulses(on), seed, open_share=OPEN_SHARE) for seed in seeds] for on in (BRIEF_US, LONG_US)
    )
    mean, half = change(brief, long, lambda cut: cut.gap_um)
    return [
        Row.sign("kerf", f"gap at the discharges of a rough cut, on-time {BRIEF_US:g} to {LONG_US:g} us", WIDER,
                 rises=True, simulated=mean, uncertainty=half, unit="um", note=GAPS),
    ]


def rough_pulses(t_on_us: float) -> Machine:
    """Return the rough cut with another on-time, its peak and its pause as they are."""
    rough = rough_rig(ROUGH_MM)
    return rough.with_(t_on_us=t_on_us, t_period_us=t_on_us + rough.t_period_us - rough.t_on_us)


FINE_MJ, FINE_ON_US = 0.05, 0.2
COARSE_MJ, COARSE_ON_US = 10.0, 1.4
"""A pulse of fine cuts and one of rough cuts, triangles both (ours: usual orders)."""
SIDE_MM, SIDE_V, SIDE_PA = 5.0, 80.0, 0.2e5
"""Of both: height (ours: fine pulses cut slowly), open voltage, the nominal one of the ignition law, and pressure of
the nozzles (ours: that of trims, as sheet is flushed)."""
BEGUN_UM = 10.0
"""Gap of the slot that is there (ours: no wider than what fine pulses leave, or the slot would be measured)."""
SETTLED_UM, KERF_UM, LONGEST_S = 40.0, 20.0, 600.0
"""Travel until the kerf is that of the pulses, length of kerf that is measured, and machine time for both (ours)."""
FEW = 3
"""Seeds of these slots (ours: the fine pulses of a slot are five million)."""


def side_gap_over_energy(seeds: Sequence[int]) -> list[Row]:
    """Side gap of a slot cut with fine pulses and with those of a rough cut."""
    fine, coarse = (
        [side_gap_um(slot_rig(energy, on), seed) for seed in seeds[:FEW]]
        for energy, on in ((FINE_MJ, FINE_ON_US), (COARSE_MJ, COARSE_ON_US))
    )
    mean, half = mean_and_interval([b - a for a, b in zip(fine, coarse, strict=True)])
    return [
        Row.sign("kerf", f"side gap, {FINE_MJ:g} to {COARSE_MJ:g} mJ per discharge at {SIDE_V:g} V", WIDER,
                 rises=True, simulated=mean, uncertainty=half, unit="um", note=GAPS),
    ]


def slot_rig(energy_mJ: float, t_on_us: float) -> Machine:
    """Return a production machine with triangles of an energy and a length, the pause as in rough cuts."""
    burning_V = Machine.load().material.burning_voltage_V.value
    machine = Machine.load(
        "production", generator="production", height_mm=SIDE_MM, open_voltage_V=SIDE_V, t_on_us=t_on_us,
        t_period_us=t_on_us + ROUGH_PERIOD_US - COARSE_ON_US, flushing_lower_Pa=SIDE_PA, flushing_upper_Pa=SIDE_PA,
        peak_current_A=2 * energy_mJ * 1e3 / (burning_V * t_on_us),
    )
    return altered(machine, UNBREAKABLE)


def side_gap_um(machine: Machine, seed: int) -> float:
    """Cut a slot: half of what its kerf is wider than the wire; NaN if it jams or takes longer than `LONGEST_S`."""
    plant = begin(machine, seed, gap_um=BEGUN_UM)
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

HOLE_UM = 20.0
SPEEDS_M_S = (0.0, 1.0, 2.0)
"""Gap and mean flow speeds of figure 2-9."""
SPARK_A = 1.2
"""Current of the discharges (ours, the source names none: craters so small that the hole keeps its gap to 2 um)."""
HOLES, BEFORE, MEASURED = 6, 1, 1
"""Holes per seed, windows of 25 ms until the debris is steady where water flows, and windows measured."""


def delay_in_debris(seeds: Sequence[int]) -> list[Row]:
    """Mean delay among the debris that discharges leave, over the speed of the water that carries it off.

    Craters remove metal here, as nothing else makes debris; whatever else moves or clears the water stays off.
    """
    delay = {
        speed: [
            waited_us([window for hole in range(HOLES) for window in in_debris(speed, HOLES * seed + hole)])
            for seed in seeds
        ]
        for speed in SPEEDS_M_S
    }
    rows = []
    for k in range(len(SPEEDS_M_S) - 1):
        slow, quick = SPEEDS_M_S[k : k + 2]
        mean, half = mean_and_interval([b - a for a, b in zip(delay[slow], delay[quick], strict=True)])
        rows.append(
            Row.sign("ignition", f"mean delay among debris, flow {slow:g} to {quick:g} m/s", REMAINS, rises=True,
                     simulated=mean, uncertainty=half, unit="us", note=FLOW)
        )
    return rows


def waited_us(windows: Sequence[PulseWindow]) -> float:
    """Mean delay of the pulses that were no shorts, an open one counted with the whole on-time; NaN if all were."""
    lit = sum(w.mean_delay_us * (w.spark + w.arc) for w in windows if w.spark + w.arc)
    opened, pulses = sum(w.open for w in windows), sum(w.pulses - w.short for w in windows)
    return (lit + THESIS_ON_US * opened) / pulses if pulses else math.nan


def in_debris(speed_m_s: float, seed: int) -> list[PulseWindow]:
    """Pulses of figure 2-9 in a hole that their own debris fills and the flow empties."""
    still, metal = thesis_machine(speed_m_s), Machine.load().material
    ohm = (still.generator.open_voltage_V.value - metal.burning_voltage_V.value) / SPARK_A
    constants = {"material.removal_mm3_J": metal.removal_mm3_J.value, "generator.resistance_ohm": ohm}
    plant = in_a_hole(altered(still, constants), hole_gap_um(still, HOLE_UM, seed), seed)
    return [plant.advance() for _ in range(BEFORE + MEASURED)][BEFORE:]


CHECKS: tuple[Check, ...] = (gap_over_energy, side_gap_over_energy, delay_in_debris)
