"""Pulse periods at which a wire survives a whole cut: `python docs/make/held_periods.py` prints a table.

The table is in guide/set-up.md: `examples/punch.ngc` on the production machine with the large table, its generator,
the planner `exact`, which lets the feed follow the gap, and defaults otherwise. It takes a quarter of an hour.
"""

from sections import DOCS, table

import edmsim

PROGRAM = DOCS.parent / "examples" / "punch.ngc"
HEIGHTS_MM = (20.0, 40.0, 80.0)
PERIODS_US = (20.0, 32.0, 40.0, 50.0, 72.0)


def ended(height_mm: float, period_us: float) -> str:
    """Return the wire's highest temperature, or the time when it broke, as text."""
    report = edmsim.cut(
        PROGRAM, machine="production-400", planner="exact", generator="production", height_mm=height_mm,
        t_period_us=period_us, resolution="fast",
    ).report  # fmt: skip
    if report["outcome"] == "finished":
        return f"{report['wire']['temperature_K_max']:.0f} K"
    return f"{report['outcome']} at {report['machining_time_s']:.1f} s"


def main() -> None:
    """Print the table."""
    rows = ([f"{height:g}", *(ended(height, period) for period in PERIODS_US)] for height in HEIGHTS_MM)
    print(table(["height, mm", *(f"{period:g} us" for period in PERIODS_US)], rows))


if __name__ == "__main__":
    main()
