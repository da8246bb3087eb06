"""Sensitivity of failing rows to resolution, running speed, heat into the wire, wear; tables of theory/emergence.md.

python docs/make/sensitivity.py
"""

from collections.abc import Mapping, Sequence
from statistics import fmean

from sections import table, write_sections

from edmsim.closed_loop.straight import Cut, cut_straight
from edmsim.controllers import from_text
from edmsim.evaluation.stable_rate import quick_counts
from edmsim.machine.machine import Machine
from edmsim.plant.resolution import RESOLUTIONS, Resolution
from edmsim.validation.breakage import ROUGH_MM, mori_cut, mori_rig, rough_rig
from edmsim.validation.cuts import drum_um
from edmsim.validation.lag import DEFAULT_S, DRUM_MM, PRODUCTION_S, ROUGH_OPEN_SHARE
from edmsim.validation.setups import UNBREAKABLE, altered
from edmsim.validation.stable_rate import FLUSHED_MM, QUICKER, THIN_MM, preset, rates_mm2_min, thin_rig

SEEDS, ROUGH_S = (1, 2), 2.0
FINER = {"25 slices, 24 modes": Resolution(25, 128, 24, film_spans=2), "40, 31": Resolution(40, 64, 31, film_spans=2)}
SEARCHES = tuple(range(1, 21))  # seeds of searches whose differences are small
MORI = (1, 2, 3, 4, 5, 6, 7, 8)
WIRE_SPEEDS_M_S, HEAT_SHARES, THIN_PEAKS_A = (0.05, 0.1, 0.2), (0.1, 0.15, 0.2), (75.0, 150.0)
WEAR_RATIOS = (0.1, 1.0, 3.0)
HEAT, WEAR = "base.cooling.wire_heat_share", "base.discharge.wear_ratio"


def _table(head: str, columns: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    return table((head, *columns), [(name, *cells) for name, cells in rows.items()])


def _cuts(machine: Machine, resolution: str | Resolution, seconds: float) -> list[Cut]:
    return [
        cut_straight(machine, from_text(quick_counts(ROUGH_OPEN_SHARE)), seed, settle_s=seconds, seconds=seconds,
                     resolution=resolution)
        for seed in SEEDS
    ]  # fmt: skip


def rough() -> str:
    """Return lag, vibration, shorts and feed of the rough cut at ever finer resolutions."""
    names = [f"{name} ({r.slices}, {r.modes})" for name, r in RESOLUTIONS.items()] + list(FINER)
    cuts = [_cuts(rough_rig(ROUGH_MM), one, ROUGH_S) for one in (*RESOLUTIONS, *FINER.values())]
    return _table("", names, {
        "lag, um": [f"{fmean(cut.lag_um for cut in of):.1f}" for of in cuts],
        "rms vibration, um": [f"{fmean(cut.vibration_um for cut in of):.1f}" for of in cuts],
        "shorts, %": [f"{100 * fmean(cut.share('short') for cut in of):.1f}" for of in cuts],
        "feed, um/s": [f"{fmean(cut.feed_um_s for cut in of):.0f}" for of in cuts],
    })  # fmt: skip


def tall() -> str:
    """Return the figures that fail at large heights, at two resolutions."""
    production = {
        mm: altered(Machine.load("production", generator="production", height_mm=mm), UNBREAKABLE)
        for mm in (DRUM_MM, 120.0)
    }
    found = [
        (
            fmean(cut.lag_um for cut in _cuts(production[120.0], name, PRODUCTION_S)),
            fmean(cut.lag_um for cut in _cuts(Machine.load(height_mm=80.0), name, DEFAULT_S)),
            fmean(drum_um(cut) / 2 for cut in _cuts(production[DRUM_MM], name, PRODUCTION_S)),
        )
        for name in ("fast", "default")
    ]
    names = "lag, production machine, 120 mm, um", "lag, default cut, 80 mm, um", "hollow of the wall, 40 mm, um"
    rows = {name: [f"{one[k]:.1f}" for one in found] for k, name in enumerate(names)}
    return _table("", ("fast", "default"), rows)


def mori() -> str:
    """Return the number of runs in which Mori's wire breaks, by its speed and its share of the heat."""

    def broken(speed_m_s: float, share: float) -> str:
        machine = altered(mori_rig().with_(wire_speed_m_s=speed_m_s), {HEAT: share})
        cuts = [mori_cut(machine, seed) for seed in MORI]
        warmest_K = fmean(max(window.wire_temperature_K for window in cut.windows) for cut in cuts)
        return f"{sum(cut.broken for cut in cuts)} of {len(cuts)}, {warmest_K:.0f} K"

    rows = {f"{speed:g} m/s": [broken(speed, share) for share in HEAT_SHARES] for speed in WIRE_SPEEDS_M_S}
    return _table("running speed", [f"heat share {share:g}" for share in HEAT_SHARES], rows)


def thin() -> str:
    """Return the greatest stable rate of a wire of 0.1 mm, by height, peak and its share of the heat."""

    def rate(height_mm: float, peak_A: float, share: float) -> str:
        return f"{fmean(rates_mm2_min(altered(thin_rig(height_mm, peak_A), {HEAT: share}), SEARCHES[:4])):.0f}"

    rows = {
        f"{height:g} mm, {peak:g} A": [rate(height, peak, share) for share in HEAT_SHARES]
        for height in THIN_MM for peak in THIN_PEAKS_A
    }  # fmt: skip
    return _table("rate, mm2/min", [f"heat share {share:g}" for share in HEAT_SHARES], rows)


def worn() -> str:
    """Return the greatest stable rate, and that at `QUICKER` times the running speed, by the wire's wear."""
    usual, quick = [], []
    base = preset(FLUSHED_MM)
    for ratio in WEAR_RATIOS:
        quicker = base.with_(wire_speed_m_s=QUICKER * base.base.guides.wire_speed_m_s.value)
        usual.append(fmean(rates_mm2_min(altered(base, {WEAR: ratio}), SEARCHES)))
        quick.append(fmean(rates_mm2_min(altered(quicker, {WEAR: ratio}), SEARCHES)))
    return _table("wire lost per workpiece removed", [f"{ratio:g}" for ratio in WEAR_RATIOS], {
        "rate, mm2/min": [f"{rate:.1f}" for rate in usual],
        f"at {QUICKER:g} times the running speed": [f"{rate:.1f}" for rate in quick],
    })  # fmt: skip


if __name__ == "__main__":
    write_sections("theory/emergence.md", {
        "rough cut by resolution": rough(),
        "misses at height by resolution": tall(),
        "Mori's rig by speed and heat": mori(),
        "thin wire by heat": thin(),
        "rate by wear": worn(),
    })  # fmt: skip
