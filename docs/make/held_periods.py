"""Which pulse periods hold from the start hole on: `python docs/make/held_periods.py` prints a table.

It is one of guide/set-up.md. Cuts of `examples/punch.ngc` on the production machine, with its generator and all else
as preset, end after 40 s: a wire that breaks of its pulses does so at the first contact, or on its way out of the
hole.
"""

from __future__ import annotations

from pathlib import Path

import edmsim

PROGRAM = Path(__file__).parents[2] / "examples" / "punch.ngc"
HEIGHTS_MM = (20.0, 40.0, 80.0)
PERIODS_US = (9.4, 20.0, 27.0, 32.0, 40.0)
MOST_S = 40.0


def ended(height_mm: float, period_us: float) -> str:
    """Say when the wire broke, or how hot it became."""
    report = edmsim.cut(
        PROGRAM, machine="production", generator="production", height_mm=height_mm, t_period_us=period_us,
        max_time_s=MOST_S, resolution="fast", seed=1,
    ).report  # fmt: skip
    if report["outcome"] == "time-limit":
        return f"{report['wire']['temperature_K_max']:.0f} K"
    return f"{report['outcome']} at {report['machining_time_s']:.1f} s"


def main() -> None:
    """Print the table."""
    print("| height, mm | " + " | ".join(f"{period:g} us" for period in PERIODS_US) + " |")
    print("|---" * (1 + len(PERIODS_US)) + "|")
    for height in HEIGHTS_MM:
        print(f"| {height:g} | " + " | ".join(ended(height, period) for period in PERIODS_US) + " |", flush=True)


if __name__ == "__main__":
    main()
