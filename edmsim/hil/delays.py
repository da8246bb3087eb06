"""A table of ignition delays over gap and voltage, for circuit simulators."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edmsim.cosim.straight import begin
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import replacing
from edmsim.hil.gap import check_gap
from edmsim.machine.machine import Machine
from edmsim.machine.parts import Constant
from edmsim.plant.workpiece.blanks import started_slot

GAPS_UM = (4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0)
VOLTAGES_V = (60.0, 80.0, 100.0, 120.0)
QUANTILES = (0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95)
DRAWS = 200  # pulses per gap and voltage (ours: the median's error is a tenth of the delays' spread)
WAIT_US = 10_000.0  # a pulse that has not ignited by then counts as not ignited


class Delays(NamedTuple):
    """Delays of a gap at a voltage."""

    gap_um: float
    open_V: float
    # shares of pulses that were shorts, and that ignited within `WAIT_US`
    short: float
    ignited: float
    # `QUANTILES` of the delays of all pulses except shorts, in us; NaN if a quantile has not ignited
    us: tuple[float, ...]


@refuses_wrong_types
def delay_table(
    machine: Machine, *, gaps_um: Sequence[float] = GAPS_UM, voltages_V: Sequence[float] = VOLTAGES_V,
    draws: int = DRAWS, seed: int = 0, watch: Callable[[int, int], None] | None = None,
) -> list[Delays]:
    """Draw delays of a set-up at gaps and voltages.

    Every pulse is the first one of a wire at rest in clean water, in a slot with the same gap all round and the
    machine's height. In a cut, debris, gas and the wire's vibration change the delays.

    Parameters
    ----------
    machine : Machine
    gaps_um, voltages_V : sequence of float
    draws : int
        Pulses of each.
    seed : int
    watch : callable, optional
        Called with the numbers of finished and of all rows.

    Raises
    ------
    InputError
        If a gap or a voltage cannot be used, or there is nothing to draw.
    """
    if draws < 1 or not len(gaps_um) or not len(voltages_V):
        raise InputError("a table of delays needs gaps, voltages, and 1 or more pulses of each")
    for gap_um in gaps_um:
        check_gap(machine, gap_um)
    rows: list[Delays] = []
    for open_V in voltages_V:
        patient = _patient(machine, open_V)
        for gap_um in gaps_um:
            rows.append(_row(patient, gap_um, open_V, draws, seed + 1000 * len(rows)))
            if watch is not None:
                watch(len(rows), len(voltages_V) * len(gaps_um))
    return rows


def write_delays(rows: Sequence[Delays], file: Path) -> None:
    """Write a table as CSV; the field of a quantile that has not ignited is empty."""
    names = [f"p{100 * quantile:02.0f}_us" for quantile in QUANTILES]
    lines = [",".join(["gap_um", "open_V", "short_share", "ignited_share", *names])]
    for row in rows:
        delays = ["" if np.isnan(us) else f"{us:.3f}" for us in row.us]
        lines.append(
            ",".join([f"{row.gap_um:g}", f"{row.open_V:g}", f"{row.short:.3f}", f"{row.ignited:.3f}", *delays])
        )
    with replacing(file) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _patient(machine: Machine, open_V: float) -> Machine:
    """Return a machine with this voltage whose generator waits long for an ignition."""
    if not machine.material.burning_voltage_V.value < open_V <= 1000.0:
        raise InputError(f"{open_V:g} V ignite nothing: give more than the burning voltage, and at most 1000 V")
    changes = {
        "mode": "iso-energetic", "supply_voltage_V": None,
        "open_voltage_V": Constant(value=open_V, source="table of delays"),
        "ignition_wait_us": Constant(value=WAIT_US, source="table of delays"), "equalising": None,
        "mean_current_limit_A": Constant(value=10_000.0, source="table of delays"),
    }  # fmt: skip
    own = machine.generator.model_copy(update=changes)
    free = dict.fromkeys(("open_voltage_V", "peak_current_A", "resistance_ohm", "ignition_wait_us"))
    patient = machine.model_copy(update={"generator": own, **free})
    patient.check()
    return patient


def _row(machine: Machine, gap_um: float, open_V: float, draws: int, seed: int) -> Delays:
    centre_um = machine.base.table.centre_um
    stock = started_slot(machine, centre_um, gap_um=gap_um)
    plant = begin(machine, seed, gap_um=gap_um)
    plant.watch_pulses()
    shorts, delays = 0, []
    for draw in range(draws):
        if draw:
            plant.reset(seed + draw, stock=stock, position_um=centre_um)
        window = plant.advance(pulses=1)
        shorts += window.short
        if not window.short:
            delays.append(window.mean_delay_us if window.spark + window.arc else np.inf)
    found = np.quantile(delays, QUANTILES, method="inverted_cdf") if delays else np.full(len(QUANTILES), np.nan)
    ignited = sum(np.isfinite(delays)) / draws
    return Delays(
        gap_um, open_V, shorts / draws, float(ignited), tuple(float(v) if v < np.inf else np.nan for v in found)
    )
