"""Rows on the highest stable rate: effects of pressure, wire speed, a nozzle, the height and a thin wire.

The rate is searched by `edmsim.evaluation.stable_rate`, which shortens the pauses until the wire breaks, the cut jams
or the generator has no shorter period, on the default production machine.
"""

import math
from collections.abc import Sequence

from edmsim.evaluation.stable_rate import highest_stable_rate
from edmsim.machine.machine import Machine
from edmsim.validation.breakage import OFF_MM
from edmsim.validation.rows import Checks, Row, Seeds, differences, extended, mean_and_interval
from edmsim.validation.setups import PRACTICE

NOTE = "docs/theory/emergence.md#greatest-stable-rate"
HOLD_S, APPROACH_S = 0.4, 6.0
"""Time at each step (ours: twenty time constants of the wire), and initial time in which the feed settles."""
# ours: jets of 16 bar bend the wire by 30 um before it fires, so the servo approaches too fast and needs 4 s to
# settle; a search that began earlier would report a jam

PAIRED = 20  # seeds for differences as small as a step of the search
# Ours: a search shortens the period by 5 %, so the least effect to detect is 5 %, 7 mm2/min on 40 mm, and half of it
# is the interval. The differences of eight seeds had a standard deviation of 7.4 mm2/min: 2.09 x 7.4 / sqrt(20) =
# 3.5.


def preset(height_mm: float) -> Machine:
    """Return the default production machine and generator: 0.25 mm brass, 10 N, 2 bar, 13 m/min."""
    return Machine.load("production", generator="production", height_mm=height_mm)


def rates_mm2_min(machine: Machine, seeds: Seeds) -> list[float]:
    """Search the greatest stable rate with every seed."""
    return [
        highest_stable_rate(machine, seeds=(seed,), hold_s=HOLD_S, approach_s=APPROACH_S).rate_mm2_min
        for seed in seeds
    ]


def _sign(name: str, source: str, rises: bool, before: Sequence[float], after: Sequence[float]) -> Row:
    return Row.sign("stable rate", name, f"{PRACTICE}: {source}", rises=rises, simulated=differences(before, after),
                    unit="mm2/min", note=NOTE)


FLUSHED_MM, TALL_MM = 40.0, 60.0  # heights at which flushing and wire speed are changed, and at which a nozzle is off
WEAK_PA, STRONG_PA, STRONGEST_PA = 0.5e5, 4e5, 16e5
LEVEL = 0.25  # greatest relative change of the rate from strong flushing to four times as strong, for "level"
QUICKER = 3.0


def water_and_wire(seeds: Seeds) -> list[Row]:
    """Compare the effects of pressure, a nozzle and the wire's speed on the rate."""
    base = preset(FLUSHED_MM)
    weak, strong, strongest = (
        rates_mm2_min(base.with_(flushing_lower_Pa=pressure, flushing_upper_Pa=pressure), seeds)
        for pressure in (WEAK_PA, STRONG_PA, STRONGEST_PA)
    )
    quicker = base.with_(wire_speed_m_s=QUICKER * base.base.guides.wire_speed_m_s.value)
    usual, quick = (rates_mm2_min(machine, extended(seeds, PAIRED)) for machine in (base, quicker))
    both = rates_mm2_min(preset(TALL_MM), seeds)
    one = rates_mm2_min(preset(TALL_MM).with_(standoff_upper_mm=OFF_MM), seeds)
    ratio = [b / a if a > 0.0 else math.nan for a, b in zip(strong, strongest, strict=True)]
    return [
        _sign(f"greatest stable rate, {FLUSHED_MM:g} mm, {WEAK_PA / 1e5:g} to {STRONG_PA / 1e5:g} bar",
              "rises with the flushing pressure", True, weak, strong),
        Row.value("stable rate", f"greatest stable rate, {FLUSHED_MM:g} mm, "
                  f"{STRONGEST_PA / 1e5:g} over {STRONG_PA / 1e5:g} bar", f"{PRACTICE}: then levels off",
                  published=1.0, simulated=ratio, within=LEVEL, note=NOTE),
        _sign(f"greatest stable rate, {FLUSHED_MM:g} mm, wire speed x{QUICKER:g}", "a quicker wire clearly gains",
              True, usual, quick),
        _sign(f"greatest stable rate, {TALL_MM:g} mm, a nozzle off", "one nozzle off is a clear loss", False, both,
              one),
    ]


LOW_MM, BEST_MM, HIGH_MM = 15.0, 40.0, 120.0
"""Heights below, within and above the range with the greatest rate in area per time."""


def heights(seeds: Seeds) -> list[Row]:
    """Compare the rate over the workpiece's height."""
    low, best, high = (rates_mm2_min(preset(height), seeds) for height in (LOW_MM, BEST_MM, HIGH_MM))
    most = "greatest between some 30 and 60 mm, then a slow fall"
    return [
        _sign(f"greatest stable rate, {LOW_MM:g} to {BEST_MM:g} mm high", most, True, low, best),
        _sign(f"greatest stable rate, {BEST_MM:g} to {HIGH_MM:g} mm high", most, False, best, high),
    ]


THIN_MM = (10.0, 20.0)
THIN_N, THIN_ON_US = 4.0, 0.7
"""Tension and on-time of a brass wire of 0.1 mm (ours: usual orders; half of the strength, half of a rough pulse)."""
THIN_PEAKS_A = (75.0, 150.0, 300.0)  # peak currents, 0.6 to 2.3 mJ per discharge (ours: a shop searches the best one)


def thin_wire(seeds: Seeds) -> list[Row]:
    """Compare the rate of a wire of 0.1 mm, at the best peak current."""
    rows = []
    for height in THIN_MM:
        runs = [rates_mm2_min(thin_rig(height, peak), seeds) for peak in THIN_PEAKS_A]
        rows.append(Row.band("stable rate", f"greatest stable rate, 0.1 mm wire, {height:g} mm high",
                             f"{PRACTICE}: 10 to 20 mm2/min", low=10.0, high=20.0, unit="mm2/min",
                             simulated=max(runs, key=mean_and_interval), note=NOTE))
    return rows


def thin_rig(height_mm: float, peak_A: float) -> Machine:
    """Return the production machine with a brass wire of 0.1 mm and pulses for it."""
    return Machine.load(
        "production", generator="production", wire="brass-100", height_mm=height_mm, tension=THIN_N,
        t_on_us=THIN_ON_US, peak_current_A=peak_A,
    )


CHECKS: Checks = dict.fromkeys((water_and_wire, heights, thin_wire), ("stable rate",))
