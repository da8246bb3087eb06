"""A UHU on the bench, for the tests of its rows."""


import numpy as np

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis.drive import axis_row
from edmsim.controllers.axis.uhu import POSITION, TARGET, Uhu

BANNER = b"UHU Servo Controller 3.00 (c) Snr: 134\r\nEEPROM: OK\r\nHelp by (?)\r\n>"
BAD_BANNER = BANNER.replace(b"OK", b"Error!")
SAMPLE_SET = {  # of the manual's help text
    "proportional_gain": 900, "integral_gain": 24, "speed_gain": 260, "acceleration_gain": 400, "speed_limit": 300,
    "torque_limit": 255, "output_filter": 150, "error_limit": 2000, "step_multiplier": 0, "cycle": 50,
}  # fmt: skip
HELP = """(P)rop.      900
(I)nt.       24
(D)iff.      260
(H)iOrd.     400
Ma(X)        300
(T)orque     255
I(N)ertance  150
(E)rror      2000
(M)ult.       0
(O)verrun    0
(C)ycle      50
(L)oad       [0,1,2]
(S)ave       [0,1,2]
(G)o         [Wert]
(C)ounter
(R)eset
"""


def bench_with(*drives):
    """Some UHUs on the axes x, y, ..., just powered up, their start-up text sent."""
    bench = AxisBench(dict(zip("xyuv", drives, strict=False)))
    bench.run(0.03)
    return bench


def tuned(axis="bench", *, changes=None, **parameters):
    """A UHU with good banks on an axis, running."""
    return bench_with(Uhu(axis_row(axis, **(changes or {})), stored=parameters))


def delivered():
    """A UHU in its condition upon delivery."""
    return bench_with(Uhu(axis_row("bench")))


def ask(bench, text, axis="x", run_s=0.0):
    """Type a line; what comes back without the echo and the prompt; the bench then runs for some time."""
    said = bench.talk(text.encode() + b"\r", axis=axis).decode("ascii")
    assert said.startswith(text + "\r\n"), said
    assert said.endswith(">"), said
    bench.run(run_s)
    return said.removeprefix(text).removesuffix(">").strip("\r\n")


def stepped(bench, *steps, run_s):
    """Step x: how many, at which rate (Hz) and acceleration (Hz/s), and run for some time."""
    bench.steps("x", int(steps[0]), *steps[1:])
    bench.run(run_s)


def moved(bench, counts, run_s):
    """Let x go some counts, and run for some time."""
    bench.drive("x").go(counts)
    bench.run(run_s)


def count(bench, axis="x"):
    """Where the chip says the axis is."""
    return register(bench, POSITION, axis)


def error(bench, axis="x"):
    """The tracking error in counts at the last sample."""
    return register(bench, TARGET, axis) - register(bench, POSITION, axis)


def register(bench, place, axis="x"):
    return int(bench.drive(axis).record["reg"][0, place])


def traced(bench, seconds, axis="x"):
    """Samples of a time."""
    bench.trace = True
    bench.samples(axis)
    bench.run(seconds)
    return np.array(bench.samples(axis))


def start_stream(bench, axis="x"):
    """Start analyse mode; the line is never quiet from then on."""
    bench.send(b"A\r", axis=axis)
    bench.run(0.02)
