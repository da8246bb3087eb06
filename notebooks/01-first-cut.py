# ---
# jupyter:
#   edmsim:
#     small: {resolution: fast, height_mm: 5.0, max_time_s: 12.0}
#   jupytext:
#     formats: ipynb,py:percent
#     notebook_metadata_filter: edmsim,kernelspec,jupytext,-all
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A first cut
#
# **Question.** What are the results of a simulated cut, and how far can you trust them?
#
# A punch of 10 x 6 mm is cut from 20 mm of tool steel, discharge by discharge, with the default settings: a brass
# wire of 0.25 mm, the feed law `counts`, and the generator of a laboratory machine of 1982. In a shell the command
# is `edmsim cut examples/punch.ngc --seed 1 --out out/punch`.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import edmsim
from edmsim.recording.figures.cut import corner_figure, error_figure, kerf_figure, plane_figure, pulses_figure
from edmsim.recording.figures.palette import BLUE, GREEN, ORANGE
from edmsim.recording.report import summary
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.video import Film
from edmsim.recording.windows import column, lag_along_um

# %% tags=["parameters"]
resolution = "default"  # slices over the height, rays around the wire: "fast", "default" or "fine"
height_mm = 20.0  # of the workpiece
max_time_s = 7200.0  # machine time after which the cut stops
seed = 1  # the same seed gives the same cut, bit for bit

# %% [markdown]
# ## The program
#
# The program is G-code. `G41` offsets the wire to the left of the contour by its radius and the expected side gap.
# The contour runs clockwise, so the part is inside. You can cut any other program or drawing (DXF) in the same way.

# %%
PUNCH = """\
G21 G90
G92 X4.0 Y-1.5                 ; start hole below the lower edge
G41 D1 G1 X4.0 Y0.0
X0.0
Y4.5                           ; first sharp corner: 90 degrees to the right
G2 X1.5 Y6.0 I1.5 J0.0         ; round corner
G1 X4.2
G3 X5.8 Y6.0 I0.8 J0.0         ; half-round notch
G1 X10.0
Y1.0                           ; second sharp corner
G2 X9.0 Y0.0 I-1.0 J0.0
G1 X4.0
G40 Y-1.5
M02
"""
folder = tempfile.TemporaryDirectory()
program = Path(folder.name) / "punch.ngc"
program.write_text(PUNCH)
out = Path(folder.name) / "punch"
result = edmsim.cut(
    program, out=out, height_mm=height_mm, resolution=resolution, seed=seed, max_time_s=max_time_s,
)  # fmt: skip
print(", ".join(sorted(file.name for file in out.iterdir())))

# %% [markdown]
# `edmsim cut` writes the same files; `report.html` shows the results on one page, without Python.
#
# ## The report
#
# All figures are results of the pulse loop. Shares of shorts, kerf, lag and errors are never inputs.

# %%
report = result.report
print(f"{report['outcome']} after {report['machining_time_s']:.0f} s of machine time\n")
for name, value in summary(report)[1:]:
    print(f"{name:20} {value}")

# %% [markdown]
# ## The windows
#
# The machine counts pulses in windows of 255, the cycle of its 8-bit counters. A window is a row of the table
# (`windows.parquet`), and one decision of the feed law.

# %%
for field in result.windows.schema:
    print(f"{field.name:20} {field.metadata[b'unit'].decode():5} {field.metadata[b'meaning'].decode()}")
print(f"\n{result.windows.num_rows} windows; one of them, from the middle:")
(middle,) = result.windows.slice(result.windows.num_rows // 2, 1).to_pylist()
print(", ".join(f"{name} {value:.4g}" for name, value in middle.items()))

# %% [markdown]
# ## Short and open pulses
#
# - A **short** is a pulse whose voltage never rises: the wire touches, or debris bridges the gap. The gap is too
#   narrow.
# - An **open** pulse never ignites within its on-time: the gap is too wide.
# - A **spark** ignites after a delay and removes metal.
# - An **arc** ignites at once, on the channel of the pulse before.
#
# Short and open pulses remove hardly any metal, so a machine can control its feed by these two counts alone: faster
# while pulses are open, slower when they short. This is the law `counts`. First the wire runs through the air of
# the start hole (all open), then it meets the metal.

# %%
pulses_figure(result.windows)

# %% [markdown]
# The next figure shows short against open pulses. On the dotted line no pulse would ignite. The law aims at fewer
# open pulses, further to the left, where most pulses remove metal. But here the machine already moves at its greatest
# feed, 33.3 µm/s.

# %%
plane_figure(result.windows)

# %% [markdown]
# ## Gap, feed and lag
#
# The law commands the feed. The gap is the mean distance across which pulses ignited. The lag is the distance of
# the wire behind its guides at the workpiece; a negative lag is a wire that *leads*. Discharges push the wire back,
# the open voltage pulls it forward. At this low energy both are equally large, so the lag is small and may have
# either sign (notebook 03).

# %%
def per_second(values: np.ndarray) -> np.ndarray:
    """Mean over every second of machine time; NaN (no ignition) left out."""
    second = column(result.windows, "t_s").astype(int)
    known = np.isfinite(values)
    total, count = (np.bincount(second[known], of, minlength=second[-1] + 1) for of in (values[known], None))
    return np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)


figure, panels = plt.subplots(3, 1, figsize=(7.5, 5.0), dpi=90, sharex=True, layout="constrained")
series = (
    ("feed, µm/s", GREEN, column(result.windows, "feed_um_s")),
    ("gap, µm", BLUE, np.minimum(column(result.windows, "gap_um"), 40.0)),
    ("lag, µm", ORANGE, lag_along_um(result.windows)),
)
for axes, (label, colour, values) in zip(panels, series, strict=True):
    axes.plot(per_second(values), color=colour, lw=0.8)
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
panels[-1].set_xlabel("machine time, s (means of a second)");

# %% [markdown]
# ## The part
#
# This is the error along the edge as drawn, as a coordinate measuring machine would find it: positive where metal
# is left, negative for an undercut. It is enlarged; the bar has the scale.

# %%
error_figure(result.scene)

# %% [markdown]
# This is one corner. Guides and wire go round it on an arc. During the whole arc the corner faces the wire from two
# sides, so it is undercut. The lower panel unrolls the edge and shows the wire's deflection and the error.

# %%
corner_figure(result.scene, result.windows, 0)

# %% [markdown]
# This figure shows both walls over the height. Debris gathers at mid-height, where the water from both nozzles
# comes to rest, and lets pulses ignite across wider gaps. The bubbles of the discharges drive most of it out of the
# gap, so the bulge is small.

# %%
kerf_figure(report)

# %% [markdown]
# ## Watching it
#
# `cut.rrd` is a recording of the whole cut: `edmsim view out/punch` opens it in the viewer, or without a screen
# serves it to a browser. `edmsim report out/punch --film punch.gif` draws a film. This is one picture of that film,
# half way through the cut:

# %%
play = Playback(out / "cut.rrd")
figure, axes = plt.subplots(figsize=(9.0, 5.06), dpi=90, layout="constrained")
axes.imshow(Film(play, dpi=70).picture(report["machining_time_s"] / 2))
axes.axis("off")
folder.cleanup()

# %% [markdown]
# ## Limits
#
# One cut is one random draw. Most constants of such machines are known only within a range (`Machine.sample`,
# notebook 07), and some results of the model contradict publications (notebook 08). The slug disappears when it is
# free: it neither tips nor jams. Roughness is a lower bound.
