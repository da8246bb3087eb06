"""The push of a bubble in the slit between wire and metal; writes the tables and figure of theory/gas.md.

    python docs/make/bubble.py

The equations of `slit` are integrated for three pulses, and compared with the law of the pulse loop.
"""

import itertools
import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sections import DOCS, table, write_sections
from slit import (
    DISC,
    GAP_UM,
    GREATEST_SHARE,
    LEAST_SHARE,
    SHARE,
    WIRE_UM,
    Gas,
    Pulse,
    Push,
    Slit,
    grow,
    refill,
    strip,
)

from edmsim.plant.gap import gas
from edmsim.recording.figures.palette import BLUE, GREEN, GRID, INK, MUTED, ORANGE, VERMILION
from edmsim.recording.figures.style import write_figure

HOT, WET, AT_ONCE = 480.0, 150.0, math.inf
"""Speeds of escape in m/s: of steam of 850 C, of steam that carries spray (ours), and without any resistance."""
GAPS_UM = 13.0, 20.0, 30.0
DIAMETERS_UM = 100.0, 150.0, 200.0, 250.0, 300.0
DEFAULT, ROUGH, TRIM = Pulse(145.0, 20.0), Pulse(7000.0, 1.4), Pulse(200.0, 0.5)
PULSES = {"default, 2.9 mJ in 20 us": DEFAULT, "rough, 9.8 mJ in 1.4 us": ROUGH, "trim, 0.1 mJ in 0.5 us": TRIM}


def impulse_10mJ_Ns(slit: Slit, share: float = SHARE, heat_ratio: float = gas.HEAT_RATIO) -> float:
    """Return the law's constant from the rough pulse: the displaced water's impulse, if the gas escapes at once."""
    driven = grow(ROUGH, GAP_UM, Gas(share, AT_ONCE, heat_ratio), slit).impulse_Ns
    confined_us = gas.vent_time_us(ROUGH.power_W, GAP_UM, gas.bubble_law(WIRE_UM, 0.0, share))
    return driven / math.sqrt(ROUGH.power_W * min(ROUGH.burn_us, confined_us) * 1e-6 / gas.REFERENCE_J)


def law_uNs(pulse: Pulse, gap_um: float, constant_Ns: float, diameter_um: float = WIRE_UM) -> float:
    """Return the impulse by the law of the pulse loop, in uN s."""
    law = gas.bubble_law(diameter_um, constant_Ns, SHARE)
    return 1e6 * float(gas.bubble_impulse_Ns(pulse.power_W, pulse.burn_us, gap_um, law))


def impulses(slit: Slit, constant_Ns: float) -> str:
    """Return the table of impulses: pulses and gaps against shares, shapes and speeds of escape."""
    columns = [(slit, LEAST_SHARE), (slit, SHARE), (slit, GREATEST_SHARE), (DISC, SHARE)]
    head = ["pulse", "gap, um", *(f"{'disc' if s is DISC else 'strip'}, share {share:g}" for s, share in columns)]
    head += [f"strip, {gas.ESCAPE_M_S:g} m/s", "law", "vent, us", "peak, bar", "bubble, m/s"]
    rows = []
    for (name, pulse), gap_um in itertools.product(PULSES.items(), GAPS_UM):
        spans = [
            " .. ".join(f"{grow(pulse, gap_um, Gas(share, v), shape).impulse_Ns * 1e6:.2f}" for v in (HOT, WET))
            for shape, share in columns
        ]
        push = grow(pulse, gap_um, Gas(), slit)
        rows.append([
            name, f"{gap_um:g}", *spans, f"{push.impulse_Ns * 1e6:.2f}", f"{law_uNs(pulse, gap_um, constant_Ns):.2f}",
            f"{push.vent_us:.2f}", f"{push.pressure_Pa.max() / 1e5:.0f}", f"{push.fastest_m_s:.0f}",
        ])  # fmt: skip
    return table(head, rows)


def doubts(slit: Slit) -> str:
    """Return the table of the effect of each assumption, at the reference gap."""
    cases: dict[str, tuple[Gas, Slit, dict[str, Any]]] = {
        "nothing": (Gas(), slit, {}),
        f"share of the gas {LEAST_SHARE:g}": (Gas(LEAST_SHARE), slit, {}),
        f"{GREATEST_SHARE:g}": (Gas(GREATEST_SHARE), slit, {}),
        "speed of escape 480 m/s": (Gas(escape_m_s=HOT), slit, {}), "150 m/s": (Gas(escape_m_s=WET), slit, {}),
        "the gas gone at once": (Gas(escape_m_s=AT_ONCE), slit, {}),
        "ratio of heats 1.15": (Gas(heat_ratio=1.15), slit, {}), "1.4": (Gas(heat_ratio=1.4), slit, {}),
        "disc in place of the strip": (Gas(), DISC, {}),
        "friction 5 times the laminar": (Gas(), slit, {"drag": 5.0}),
        "the gas is out at x = 0.9": (Gas(), slit._replace(full=0.9), {}),
        "bubble of 5 um at ignition": (Gas(), slit, {"seed_um": 5.0}), "of 20 um": (Gas(), slit, {"seed_um": 20.0}),
    }  # fmt: skip
    return table(("what is changed", *PULSES), (
        [name, *(f"{grow(p, GAP_UM, gas, shape, **more).impulse_Ns * 1e6:.2f}" for p in PULSES.values())]
        for name, (gas, shape, more) in cases.items()
    ))  # fmt: skip


def facts(slit: Slit) -> str:
    """Return the figures of the law's constant and of the refill."""
    time_us, drawn_Ns, met_Ns = refill()
    low, high = impulse_10mJ_Ns(DISC, LEAST_SHARE, 1.15), impulse_10mJ_Ns(slit, GREATEST_SHARE, 1.4)
    return table(("what", "value"), [
        [f"`J0`, strip, share {SHARE:g}", f"{impulse_10mJ_Ns(slit) * 1e6:.1f} uN s"],
        [f"`J0`, disc, share {LEAST_SHARE:g}, ratio of heats 1.15", f"{low * 1e6:.1f} uN s"],
        [f"`J0`, strip, share {GREATEST_SHARE:g}, ratio of heats 1.4", f"{high * 1e6:.1f} uN s"],
        ["refill of a disc: time", f"{time_us:.0f} us"],
        ["refill of a disc: suction", f"{drawn_Ns * 1e6:+.3f} uN s"],
        ["refill of a disc: when the water meets", f"{met_Ns * 1e6:+.3f} uN s"],
    ])  # fmt: skip


def figure(slit: Slit, constant_Ns: float) -> Figure:
    """Draw the equations and the law over on-time, gap and diameter, and one bubble over time."""
    drawn = Figure(figsize=(9.0, 6.6), dpi=110, facecolor="white", layout="constrained")
    (times, gaps), (diameters, history) = drawn.subplots(2, 2)
    for pulse, longest_us, colour in ((DEFAULT, 30.0, BLUE), (ROUGH, 3.0, VERMILION)):
        on_us, near_um = np.geomspace(0.3, longest_us, 15), np.geomspace(6.0, 40.0, 12)
        for axes, at, cases in (
            (times, on_us, [(pulse._replace(burn_us=t), 20, 250) for t in on_us]),
            (gaps, near_um, [(pulse, g, 250) for g in near_um]),
            (diameters, DIAMETERS_UM, [(pulse, 20, d) for d in DIAMETERS_UM]),
        ):
            hot, wet, disc = (
                [grow(p, g, Gas(escape_m_s=v), shape, d).impulse_Ns * 1e6 for p, g, d in cases]
                for v, shape in ((HOT, slit), (WET, slit), (gas.ESCAPE_M_S, DISC))
            )
            axes.fill_between(at, hot, wet, color=colour, alpha=0.25, lw=0, label="strip, 150 .. 480 m/s")
            axes.plot(at, disc, color=colour, ls=":", label="disc, 270 m/s")
            law = [law_uNs(p, g, constant_Ns, d) for p, g, d in cases]
            axes.plot(at, law, color=colour, lw=1.6, label=f"law, {pulse.power_W:g} W")
    times.set(xscale="log", xlabel="on-time at one current, us", title="gap 20 um, wire 250 um")
    gaps.set(xscale="log", xlabel="gap, um", title="20 us (145 W), 1.4 us (7 kW), wire 250 um")
    gaps.set_xticks([6, 10, 20, 40], ["6", "10", "20", "40"])
    times.set_xticks([0.3, 1, 3, 10, 30], ["0.3", "1", "3", "10", "30"])
    diameters.set(xlabel="wire diameter, um", title="20 us (145 W), 1.4 us (7 kW), gap 20 um")
    for axes in (times, gaps, diameters):
        axes.set(yscale="log", ylabel="impulse, uN s", ylim=(0.15, 20))
        axes.set_yticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
        axes.minorticks_off()
    diameters.legend(fontsize=7, loc="upper left", ncols=2)
    _draw_history(history, grow(DEFAULT, 20.0, Gas(), slit))
    for axes in (times, gaps, diameters, history):
        axes.grid(color=GRID)
        axes.title.set(fontsize=10, color=INK)
    return drawn


def _draw_history(axes: Axes, push: Push) -> None:
    """Draw pressure and impulse of the default pulse over time."""
    axes.plot(push.time_us, push.pressure_Pa / 1e5, color=ORANGE)
    axes.set(yscale="log", xlim=(0, 24), ylim=(0.9, 300), xlabel="time, us", title="20 us at 145 W, gap 20 um, strip")
    axes.set_ylabel("pressure of the gas, bar", color=ORANGE)
    axes.axvline(push.vent_us, color=MUTED, lw=0.8, ls="--")
    axes.text(push.vent_us + 0.3, 150, "the gas reaches the edges", fontsize=8, color=MUTED)
    right = axes.twinx()
    right.plot(push.time_us, push.pushed_Ns * 1e6, color=GREEN)
    right.set_ylabel("impulse so far, uN s", color=GREEN)
    right.set_ylim(0, None)


def main() -> None:
    """Integrate, write the tables into the page, and write its figure."""
    slit = strip()
    constant_Ns = float(f"{impulse_10mJ_Ns(slit):.2g}")
    tables = {"impulses": impulses(slit, constant_Ns), "doubts": doubts(slit), "facts": facts(slit)}
    write_sections("theory/gas.md", tables)
    write_figure(figure(slit, constant_Ns), DOCS / "figures" / "bubble.png")


if __name__ == "__main__":
    main()
