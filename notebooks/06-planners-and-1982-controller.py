# ---
# jupyter:
#   edmsim:
#     small:
#       directions_deg: [0, 20, 45, 80]
#       speeds: [4]
#       cut_planners: [poscal]
#       cut_time_s: 10.0
#       bit_time_s: 3.0
#       vectors: 300
#   jupytext:
#     formats: ipynb,py:percent
#     notebook_metadata_filter: edmsim,kernelspec,jupytext,-all
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Integer planners, and the controller of 1982 at work
#
# **Question.** How straight a line can an 8-bit computer without a multiplier draw, how long does it take to answer,
# and what does that mean for a part?
#
# In a thesis of the TH Eindhoven (May 1982) an 8085 controls a wire-EDM machine. Its central routine is POSCAL: from
# position, target and speed it computes the speeds of two stepping motors. It uses additions and shifts only, because
# the 8085 has no instruction to multiply. The page "controller of 1982" (`docs/controller-1982.md`) describes the
# whole machine, and the page "planners" (`docs/planners.md`) the errors at all speeds.

# %%
# %matplotlib inline
import math
import random
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import edmsim
from edmsim.controllers.mcu.chips.bus import PORT2A, PORT2B, PORT2C
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.firmware.optimise import TICK_NS, State, optimise
from edmsim.controllers.mcu.firmware.poscal import STEP_UM
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S, POSCAL_BOUND_T, READ_OUT_T, poscal_t_states
from edmsim.controllers.mcu.firmware.timers import seconds as duration_s
from edmsim.controllers.planner.errors import around
from edmsim.controllers.planner.registry import PLANNERS, make_planner
from edmsim.recording.figures.cut import error_figure
from edmsim.recording.figures.palette import BLUE, GREEN, INK, MUTED, ORANGE, VERMILION
from edmsim.recording.windows import column

plt.rcParams.update({"figure.dpi": 90, "figure.constrained_layout.use": True, "axes.grid": True, "grid.alpha": 0.3})
COUNTING = [name for name, kind in PLANNERS.items() if kind.counts]  # all but the exact one, which has no units
COLOURS = dict(zip(COUNTING, (BLUE, VERMILION, GREEN, ORANGE), strict=True))

# %% tags=["parameters"]
directions_deg = list(range(0, 360, 5))  # of the straight moves
speeds = [4, 127]  # units of 262.5 nm/s
cut_planners = ["poscal", "poscal-literal", "sine-table", "dda"]  # a part is cut with
cut_time_s = 600.0  # machine time after which its cuts stop
bit_time_s = 30.0  # machine time of the comparison bit for bit
vectors = 20_000  # displacements whose cost is counted

# %% [markdown]
# ## One move
#
# Four planners move 2.5 mm along an oblique line at low speed:
#
# - `poscal-literal` is the algorithm of the thesis. It computes the speeds of the axes once, in whole units, and each
#   axis stops at its own target.
# - `poscal` runs the same integer routines, but after every step it aims them again at a point 32 µm ahead.
# - `sine-table` does the same with a table of 255 sines in place of the square root, as the thesis proposes.
# - `dda` follows the ideal line as closely as whole steps allow.

# %%
RUN_UM = (2400, 700)
SPEED = 4


def positions_um(planner: str) -> np.ndarray:
    """Position counters after every step of the move."""
    start = np.array((30_000, 30_000))
    steps = make_planner(planner, np.array([start, start + RUN_UM])).advance(0, 10**13, SPEED)
    moved = np.zeros((len(steps), 2))
    moved[np.arange(len(steps)), [step.axis for step in steps]] = [STEP_UM * step.direction for step in steps]
    return moved.cumsum(axis=0)


figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.6))
length = math.hypot(*RUN_UM)
for planner, colour in COLOURS.items():
    place = positions_um(planner)
    left.plot(*place.T, color=colour, lw=1.2, label=planner)
    off = place @ (-RUN_UM[1] / length, RUN_UM[0] / length)
    right.plot(place @ RUN_UM / length, off, color=colour, lw=0.8)
    print(f"{planner:15} {np.abs(off).max():7.2f} µm off the line, ends {math.dist(place[-1], RUN_UM):.1f} µm off")
left.set(xlabel="x, µm", ylabel="y, µm", title=f"{SPEED} units of speed")
left.legend(fontsize=8)
right.set(xlabel="along the line, µm", ylabel="off the line, µm", xlim=(0, 300), ylim=(-3, 3), title="its beginning");

# %% [markdown]
# ## Every direction
#
# The next figure shows the largest distance from a line of 2.5 mm in every direction. A step of the motors is 2 µm,
# so no planner can be better than about 1 µm.

# %%
figure, panels = plt.subplots(1, len(speeds), figsize=(5.0 * len(speeds), 3.6), sharey=True, squeeze=False)
worst = {}
for axes, speed in zip(panels[0], speeds, strict=True):
    for planner, colour in COLOURS.items():
        errors = around(planner, 2500, speed, directions_deg)
        worst[planner, speed] = errors[:, 0].max()
        axes.plot(directions_deg, errors[:, 0], ".", ms=4, color=colour, label=planner)
    axes.axhline(STEP_UM, color=MUTED, ls="--", lw=0.8)
    axes.set(yscale="log", ylim=(0.7, 500), xlabel="direction of the move, degrees")
    axes.set(title=f"{speed} units: {speed * 0.2625:.1f} µm/s")
panels[0][0].set_ylabel("largest path error, µm (dashed: one step)")
panels[0][-1].legend(fontsize=8)
for (planner, speed), error in worst.items():
    print(f"{planner:15} {speed:4} units   {error:8.2f} µm")
    assert planner == "poscal-literal" or error < STEP_UM

# %% [markdown]
# Moves along an axis have no error, so they do not appear on the logarithmic scale. Three planners stay within one
# step in every direction and at both speeds. The algorithm of 1982 does not. At low speed one unit of speed is
# coarse, and at any speed the rounding of REDUC, which reduces numbers to 8 bits, is never corrected on the way.
# The arithmetic is good enough: computed again at every step, as `poscal` does, it keeps the line as well as `dda`.
#
# ## Effect on the part
#
# Each planner cuts a lozenge with oblique sides from 10 mm of tool steel. At the corners the offset path is an arc,
# which the planners follow as chords.

# %%
LOZENGE = """\
G21 G90
G0 X-0.4 Y0.8
G41 D1 G1 X0.0 Y0.8
X0.9 Y1.6
X2.0 Y0.9
X1.1 Y0.0
X0.0 Y0.8
M2
"""
folder = tempfile.TemporaryDirectory()
program = Path(folder.name) / "lozenge.ngc"
program.write_text(LOZENGE)
cuts = {}
print("planner          profile error, µm: max     rms")
for planner in cut_planners:
    cuts[planner] = edmsim.cut(
        program, planner=planner, height_mm=10.0, resolution="fast", seed=1, max_time_s=cut_time_s
    )
    error = cuts[planner].report["profile_error_um"]
    if error["max"] is not None:
        print(f"{planner:15} {error['max']:24.1f} {error['rms']:7.1f}")
error_figure(cuts[cut_planners[min(1, len(cut_planners) - 1)]].scene)

# %% [markdown]
# The figure shows the cut by `poscal-literal`. The rms of its error is half as large again as that of the others, and
# not many times as on a long line: the lines of this part are short, and the discharges cause most of the error.
#
# ## Behind the registers
#
# `edmsim.controllers.mcu` simulates that computer and its chips: bytes at addresses, counters and interrupts. You
# can use it by hand, here for a move of 40 by 10 µm:

# %%
computer = Computer()
computer.init()
computer.set_position(1000, 2000)
computer.set_pulse_codes(0x99, 0xAA)
computer.set_speed(100)
computer.start(generator=False)
computer.move_to(1040, 2010)
steps = computer.run_until(3_000_000_000)
for name, address in (("PORT2A, V(t(i))", PORT2A), ("PORT2B, V(t(p))", PORT2B), ("PORT2C, the lines", PORT2C)):
    print(f"{name:20} {address:04X}H  {computer.bus.read(address):02X}H")
print(f"{len(steps)} steps in {steps[-1].time_ns * 1e-6:.0f} ms, position now {computer.position}")
print(f"spent {computer.t_states} T-states: {1e3 * duration_s(computer.t_states):.1f} ms")

# %% [markdown]
# ## How late it answers
#
# The 8085 runs 3.07 million T-states (clock periods) per second. How many of them POSCAL needs depends on its path
# through REDUC, the square root and two divisions. The routine that turns counts into a speed takes its own time and
# then calls POSCAL. Both have to end within one window of 255 pulses. Otherwise the computer misses the counts of the
# next window.

# %%
law = edmsim.controllers.make("counts").settings(MAX_FEED_UM_S)
chance = random.Random(1)
poscal_ms = [
    1e3 * duration_s(poscal_t_states(chance.randrange(1 << chance.randrange(1, 17)), chance.randrange(1 << 12),
                                     chance.randrange(1, 128)))
    for _ in range(vectors)
]  # fmt: skip
state = State(speed=law.start)
answer_ms = []
windows = cuts[cut_planners[0]].windows
for row in windows.select(["t_s", "short", "open", "path_um"]).to_pylist():
    tick = int(row["t_s"] * 1e9) // TICK_NS & 0xFFFF
    _, cost = optimise(law, state, row["short"], row["open"], tick, int(row["path_um"]) & 0xFFFF)
    answer_ms.append(1e3 * duration_s(cost + READ_OUT_T))

figure, axes = plt.subplots(figsize=(7.0, 3.2))
bins = np.arange(0.0, 27.0, 0.25)
for costs, colour, name in (
    (poscal_ms, ORANGE, "POSCAL alone, random vectors"), (answer_ms, BLUE, "counts to speed, in the cut above")
):  # fmt: skip
    axes.hist(costs, bins, weights=np.full(len(costs), 100 / len(costs)), color=colour, label=name)
axes.axvline(1e3 * duration_s(POSCAL_BOUND_T), color=INK, ls=":", lw=1, label="no POSCAL costs more")
for period_us, ls in ((100, "-"), (50, "--"), (30, "-.")):
    axes.axvline(255e-3 * period_us, color=VERMILION, lw=1, ls=ls, label=f"window at t(p) {period_us} µs")
axes.set(xlabel="ms", ylabel="share, %", xlim=(0, 27))
axes.legend(fontsize=8)
assert max(poscal_ms) <= 1e3 * duration_s(POSCAL_BOUND_T)

# %% [markdown]
# At the usual period of 100 µs the computer has time to spare. At 30 µs a window ends before the computer has
# finished with the one before:

# %%
for period_us in (100.0, 50.0, 30.0, 20.0):
    cut = edmsim.cut(
        program, controller="mcu", height_mm=10.0, resolution="fast", seed=1, max_time_s=bit_time_s / 3,
        t_on_us=0.3 * period_us, t_period_us=period_us,
    )  # fmt: skip
    missed = [notice for notice in cut.report["notices"] if "missed" in notice]
    print(f"t(p) {period_us:4.0f} µs, {cut.windows.num_rows:5} windows:", *missed or ["none missed"])

# %% [markdown]
# ## The same law, twice
#
# The controller `counts` calls the routine directly. `mcu` runs it on the simulated computer, with its clocks,
# strobes, latches and interrupts, and its steps pass through timers and ports. Both cuts are equal, bit for bit.

# %%
twice = [
    edmsim.cut(program, controller=name, height_mm=10.0, resolution="fast", seed=1, max_time_s=bit_time_s).windows
    for name in ("counts", "mcu")
]
for name in twice[0].column_names:
    np.testing.assert_array_equal(column(twice[0], name), column(twice[1], name), name)
print(f"{twice[0].num_rows} windows, all equal")

# %% [markdown]
# ## An operator's session
#
# With `edmsim console 1982` you operate the machine yourself. Here a script types the commands after `>`. The
# routines are those of the thesis. It does not specify the dialogue, so the words are ours. On a terminal you also
# see the digits of the front panel below the dialogue.

# %%
def terminal(script: str, *options: str) -> None:
    """Type a script at the terminal and show what comes back."""
    command = [sys.executable, "-m", "edmsim", "console", "1982"]
    setting = ["--height", "30", "--resolution", "fast", "--seed", "1"]
    done = subprocess.run(
        [*command, *setting, *options], input=script, capture_output=True, text=True, errors="replace"
    )
    shown = "".join(c if c == "\n" or (c.isascii() and c.isprintable()) else "·" for c in done.stdout)
    print(shown, f"(exit status {done.returncode})", sep="\n")


terminal("""\
X -20
WAIT
POS 1000 1000
TI 40 TP 100
TI 30 TP 100
NEW 1500 1140
START
WAIT 15
STATUS
WAIT
BYE
""")

# %% [markdown]
# The terminal refuses 40 and 100 µs, because the mean current would exceed the generator's 2 A. Because of that line
# the exit status is 2. The speed in `STATUS` is the one that the law has found from the shares of short and open
# pulses.
#
# ## Its two faults
#
# The thesis ends with two faults unsolved: above a mean current of 1.5 A the sparks disturb the serial lines, and
# at a low voltage V(t(p)) the generator drops out. `--fault` injects either; how often it occurs is our assumption.
# In the first session a short draws so much current that characters on the line are changed or lost:

# %%
terminal("X 100\nWAIT\nTI 30 TP 100\nGEN ON\nWAIT 1\nSTATUS\nSTATUS\nGEN OFF\nPOS\n", "--fault", "serial-noise")

# %%
terminal("TI 10 TP 60\nNEW 32900 32500\nSTART\nWAIT\nTI 30 TP 100\nGO\nWAIT 2\nSTATUS\nSTOP\n", "--fault", "drop-out")
folder.cleanup()

# %% [markdown]
# ## Limits
#
# - The listings of 1982 are lost. The T-states are counted over the shortest loops that we would write.
# - What the thesis documents is reproduced bit for bit: the routines, their words of 16 bits, their mistakes and
#   the ports.
# - The thesis has no arcs. The planners receive them as chords.
