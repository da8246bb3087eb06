"""The greatest stable rate by height, by pressure, and without a nozzle; writes the tables of theory/emergence.md.

    python docs/make/stable_rates.py

The searches are those of the validation, on the production machine with its defaults.
"""

from collections.abc import Mapping
from statistics import fmean

from sections import table, write_sections

from edmsim.evaluation.stable_rate import highest_stable_rate
from edmsim.machine.machine import Machine
from edmsim.validation.breakage import OFF_MM
from edmsim.validation.stable_rate import APPROACH_S, FLUSHED_MM, HOLD_S, preset

SEEDS = (1, 2, 3, 4)
HEIGHTS_MM = (10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)
PRESSURES_BAR = (0.2, 0.5, 2.0, 4.0, 8.0, 16.0)
OFF_HEIGHTS_MM = (20.0, 40.0, 60.0)


def rates(head: str, machines: Mapping[float, Machine]) -> str:
    """Return a table of rate and mean current, as means of searches; machines are by the value that differs."""
    found = {
        figure: [highest_stable_rate(one, seeds=(k,), hold_s=HOLD_S, approach_s=APPROACH_S) for k in SEEDS]
        for figure, one in machines.items()
    }
    return table((head, *(f"{figure:g}" for figure in found)), [
        ("rate, mm2/min", *(f"{fmean(one.rate_mm2_min for one in of):.0f}" for of in found.values())),
        ("mean current, A", *(f"{fmean(one.current_A for one in of):.1f}" for of in found.values())),
    ])  # fmt: skip


def main() -> None:
    """Search, and write the tables into the page."""
    base = preset(FLUSHED_MM)
    pressures = {
        bar: base.with_(flushing_lower_Pa=1e5 * bar, flushing_upper_Pa=1e5 * bar) for bar in PRESSURES_BAR
    }
    write_sections("theory/emergence.md", {
        "stable rates by height": rates("height, mm", {mm: preset(mm) for mm in HEIGHTS_MM}),
        "stable rates by pressure": rates("pressure at 40 mm, bar", pressures),
        "stable rates without a nozzle": rates(
            "height with a nozzle off, mm", {mm: preset(mm).with_(standoff_upper_mm=OFF_MM) for mm in OFF_HEIGHTS_MM}
        ),
    })  # fmt: skip


if __name__ == "__main__":
    main()
