# ---
# jupyter:
#   edmsim:
#     small: {seeds: [0], most_s: 4.0}
#   jupytext:
#     formats: ipynb,py:percent
#     notebook_metadata_filter: edmsim,kernelspec,jupytext,-all
#     cell_metadata_filter: tags,-all
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A servo drive, tuned, and a cut under it
#
# **Question.** What does tuning change in a servo drive, and what does the drive change in a cut?
#
# **What is done.** A UHU 3.00 drive moves the axes of the table. It is tuned over its serial line, by a relay
# experiment and the recipe of its manual. Then a small die is cut four times: with steppers, and with the drive set
# soft, restless and tuned.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import edmsim
from edmsim.consoles.autotune import autotune, draw_move, draw_step
from edmsim.controllers.axis.drive import axis_row
from edmsim.recording.figures.palette import BLUE, GREEN, INK, VERMILION
from edmsim.recording.windows import column

plt.rcParams.update({"figure.dpi": 90, "figure.constrained_layout.use": True, "axes.grid": True, "grid.alpha": 0.3})

# %% tags=["parameters"]
seeds = [0, 1, 2]
most_s = 300.0  # machine time of a cut at most

# %% [markdown]
# ## Tuning
#
# `autotune` reports every step while it tunes the drive. The last line has the commands that set the drive to the
# values found; you can type them in `edmsim console servo`.

# %%
tuning = autotune("uhu", axis_row("table"), print)
print()
print(" ".join(tuning.lines))

# %%
figure, (step, move) = plt.subplots(1, 2, figsize=(9.0, 3.2))
draw_step(step, tuning)
draw_move(move, tuning)
step.legend(fontsize=8)
for name, measured in (("as delivered", tuning.before.figures), ("tuned", tuning.after.figures)):
    print(
        f"{name:13} overshoot {100 * measured.overshoot:5.0f} %, settled after {1e3 * measured.settling_s:4.0f} ms, "
        f"following error of a move {measured.rms:6.1f} counts rms"
    )
assert tuning.after.figures.rms < tuning.before.figures.rms

# %% [markdown]
# The values that the manual calls "pretty safe" are not safe on every axis: on this axis, with 0.4 mm of travel per
# turn, the drive oscillates and takes long to come to rest. The tuned drive makes a step of 50 counts, which is 10
# µm, in about 20 ms.
#
# ## Cuts
#
# The die is 0.8 mm wide, and a step of the machine is 2 µm, or ten counts. The soft drive has a small P, a large D
# and no I. The restless one oscillates by itself; its error limit is set to 30 µm, as a careful owner would set it.

# %%
DIE = """\
G21 G90
G0 X0.4 Y0.4
G41 D1 G1 X0.0 Y0.4
Y0.0
X0.8
Y0.8
X0.0
Y0.4
M2
"""
tuned = "uhu:" + ",".join(f"{letter}={value}" for letter, value in (tuning.values | {"E": 500}).items())
drives = {
    "steppers": "stepper", "soft": "uhu:P=20,I=0,D=255,H=0,E=500", "restless": "uhu:P=250,I=10,D=255,E=150",
    "tuned": tuned,
}


def cut_die(drive: str, seed: int) -> edmsim.CutResult:
    """Cut the die with a drive."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "die.ngc"
        program.write_text(DIE)
        return edmsim.cut(program, drive=drive, height_mm=10.0, resolution="fast", seed=seed, max_time_s=most_s)


cuts = {name: [cut_die(drive, seed) for seed in seeds] for name, drive in drives.items()}

# %%
def mean(values: list[float | None]) -> str:
    """Return the mean of what there is, as text."""
    there = [value for value in values if value is not None]
    return f"{np.mean(there):10.2f}" if there else "         –"


print("drive      ended by     following error, µm    shares of the profile error, µm rms  corners, µm  shorts, %")
print("                            rms       max         drive       wire        gap")
for name, results in cuts.items():
    reports = [result.report for result in results]
    made = [report["profile_error_um"]["shares"] for report in reports]
    print(
        f"{name:10} {reports[0]['outcome']:11}", mean([report["following_error_um"]["rms"] for report in reports]),
        mean([report["following_error_um"]["max"] for report in reports]),
        *(mean([shares[share]["rms"] for shares in made]) for share in ("drive", "wire", "gap")), " ",
        mean([corner["error_um"] for report in reports for corner in report["corners"]]), " ",
        mean([100 * report["pulse_share"]["short"] for report in reports]),
    )  # fmt: skip

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.2))
for name, colour in (("soft", VERMILION), ("tuned", BLUE), ("steppers", INK)):
    windows = cuts[name][0].windows
    error_um = np.hypot(column(windows, "following_x_um"), column(windows, "following_y_um"))
    left.plot(column(windows, "t_s"), error_um, color=colour, lw=0.6, label=name)
left.set(xlabel="machine time, s", ylabel="following error, µm")
left.legend(fontsize=8)
windows = cuts["restless"][0].windows
for axis, colour in (("x", GREEN), ("y", VERMILION)):
    error_um = column(windows, f"following_{axis}_um")
    right.plot(1e3 * column(windows, "t_s"), error_um, ".-", color=colour, lw=1.0, label=axis)
right.set(xlabel="machine time, ms", ylabel="following error, µm", title="restless")
right.legend(fontsize=8);

# %% [markdown]
# - With the tuned drive the following error is at most about a step. The drive adds hardly anything to the profile
#   error, and corners and shorts are those of the steppers.
# - The soft drive also cuts the part, but friction keeps it some 6 µm behind; at the end of the path it comes no
#   nearer, and the control stops it there. That is its share of the profile error, and its corner errors are 4 µm
#   larger than those of the steppers. The drive causes no additional shorts.
# - The restless drive oscillates before the first spark and trips at its error limit. With a wider limit the
#   oscillation would grow until the control stops the cut, because the axis is more than the wire's radius from its
#   path.
#
# ## Limits
#
# This is one motor and one drive at a feed of some 30 µm/s, which is slow for any servo.
