"""Pictures of ``docs/positioner.md``: ramps with reductions and stops, and homing searches.

python docs/make/positioner.py
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sections import DOCS

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.recording.figures.palette import BLUE, GREEN, GRID, INK, MUTED, ORANGE, VERMILION

EXAMPLE = {
    "measure": 10000, "pulse": 40000, "maxvel": 100000, "maxfollerr": 10000, "taccdec": 100, "toll": 5, "pgain": 100,
    "feedfw": 1000, "setvel": 50000, "setpos": 2000, "prsvel": 20000, "sprsvel": 10000,
}  # fmt: skip
"""The manual's example (1.9), with a greater gain."""
TRAPEZOID, EPICYCLOID = {"ramptype": 0}, {"ramptype": 1}


def bench_with(settings: dict[str, int] | None = None, **parameters: int) -> tuple[AxisBench, Eanpos]:
    """Return a bench and its device, initialised and in loop."""
    bench = AxisBench({"x": Eanpos(tcamp_ms=1, parameters={**EXAMPLE, **parameters}, settings=settings)})
    device = bench.drive("x")
    assert isinstance(device, Eanpos)
    for command in ("INIT", "LOOPON"):
        device.command(command)
    bench.run(0.002)
    return bench, device


def speeds(
    seconds: float, stop_s: float | None = None, settings: dict[str, int] | None = None, **parameters: int
) -> NDArray[np.float64]:
    """Return time (s) and theoretical speed (um/s) of a placement, with a STOP after `stop_s`."""
    bench, device = bench_with(settings, **parameters)
    device.command("START")
    rows = []
    for k in range(round(seconds * 1000)):
        if stop_s is not None and k == round(stop_s * 1000):
            device.command("STOP")
        bench.run(0.001)
        rows.append((k * 1e-3, device.theoretical[1]))
    return np.array(rows)


def homing(mode: int) -> NDArray[np.float64]:
    """Return time (s), true place (um), count, and state of the cam's input during a homing search."""
    bench, device = bench_with(prsmode=mode, tinvt=10)
    bench.home_cam("x", 500.0, 650.0)
    bench.motor("x")["index_um"], bench.motor("x")["index_phase_um"] = 400.0, 30.0
    device.home()
    rows = []
    for k in range(4500):
        bench.run(0.001)
        axis = bench.axis("x")
        rows.append((k * 1e-3, axis["place_um"], device.parameters["posit"], axis["home"]))
    return np.array(rows)


def _frame(axes: Axes, title: str, across: str, up: str) -> None:
    axes.set_title(title, fontsize=9, color=INK, loc="left")
    axes.set_xlabel(across, fontsize=8, color=MUTED)
    axes.set_ylabel(up, fontsize=8, color=MUTED)
    axes.tick_params(labelsize=8, colors=MUTED)
    axes.grid(color=GRID)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def ramps() -> Figure:
    """Return the picture of ramps."""
    figure = Figure(figsize=(9, 5.4), layout="constrained")
    (full, short), (stop, change) = figure.subplots(2, 2)
    limited = {"jerk_limit": 8000}
    for axes, curves in (
        (full, (("trapezoidal", speeds(3.6, **TRAPEZOID)), ("epicycloidal", speeds(3.6, **EPICYCLOID)),
                ("epicycloidal by gradient", speeds(3.6, settings={"gradient": 1}, **EPICYCLOID)),
                ("jerk limited", speeds(3.6, settings=limited)))),
        (short, (("rtype 0: time kept", speeds(1.2, setpos=200, **EPICYCLOID)),
                 ("rtype 1: slope kept", speeds(1.2, setpos=200, rtype=1, **EPICYCLOID)))),
        (stop, (("stopt 0: ramp finished", speeds(1.2, 0.25, **EPICYCLOID)),
                ("stopt 1: broken off", speeds(1.2, 0.25, stopt=1, **EPICYCLOID)))),
        (change, (("equal ramps", speeds(3.6)), ("rampmode 1: 0.5 s up, 2 s down", speeds(
            3.6, rampmode=1, tacc=50, tdec=200)))),
    ):  # fmt: skip
        for (label, curve), colour in zip(curves, (BLUE, VERMILION, GREEN, ORANGE), strict=False):
            axes.plot(*curve.T, color=colour, lw=1.5, label=label)
        axes.legend(fontsize=7, frameon=False, labelcolor=INK)
    _frame(full, "2000 um at 50 %", "s", "um/s")
    _frame(short, "200 um are too short for 50 %: reduction", "s", "um/s")
    _frame(stop, "STOP after 0.25 s", "s", "um/s")
    _frame(change, "Ramps up and down", "s", "um/s")
    return figure


def searches() -> Figure:
    """Return the picture of homing searches."""
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    for axes, mode, title in zip(
        figure.subplots(1, 2), (0, 1), ("Mode 0: the cam's edge loads the count", "Mode 1: the next zero pulse does"),
        strict=True,
    ):  # fmt: skip
        time_s, place_um, count, cam = homing(mode).T
        axes.axhspan(500, 650, color=GRID, label="cam")
        for k in range(2):
            axes.axhline(30 + 400 * k, color=ORANGE, lw=0.8, ls=":", label="zero pulse" if k == 0 else None)
        axes.plot(time_s, place_um, color=BLUE, lw=1.5, label="true place")
        axes.plot(time_s, count, color=VERMILION, lw=1.2, ls="--", label="posit")
        axes.fill_between(time_s, -60, -40, where=cam > 0, color=MUTED, label="enabling input")
        _frame(axes, title, "s", "um")
        axes.legend(fontsize=7, frameon=False, labelcolor=INK, loc="center right")
    return figure


if __name__ == "__main__":
    ramps().savefig(DOCS / "positioner-ramps.png", dpi=130)
    searches().savefig(DOCS / "positioner-homing.png", dpi=130)
