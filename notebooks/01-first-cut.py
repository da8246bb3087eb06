# ---
# jupyter:
#   edmsim:
#     small: {resolution: fast, height_mm: 5.0, max_time_s: 25.0}
#   jupytext:
#     formats: ipynb,py:percent
#     notebook_metadata_filter: edmsim,kernelspec,jupytext,-all
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A first cut
#
# **Question.** What does one simulated cut say, and how far can it be trusted?
#
# A punch of 10 x 6 mm is cut from 20 mm of tool steel, discharge by discharge, with the settings that hold when
# nothing else is said: a brass wire of 0.25 mm, the feed law `counts`, the generator of a laboratory machine of
# 1982. The same from a shell is `edmsim cut examples/punch.ngc --out out/punch`.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import edmsim
from edmsim.recording import Playback
from edmsim.recording.figures import corner_figure, error_figure, kerf_figure, plane_figure, pulses_figure
from edmsim.recording.figures.palette import BLUE, GREEN, ORANGE
from edmsim.recording.film import Film
from edmsim.recording.report import summary
from edmsim.recording.windows import column, lag_along_um

# %% tags=["parameters"]
resolution = "default"  # slices over the height, rays around the wire: "fast", "default" or "fine"
height_mm = 20.0  # of the workpiece
max_time_s = 7200.0  # machine time after which the cut stops
seed = 1  # the same seed gives the same cut, bit for bit

# %% [markdown]
# ## The program
#
# G-code as a wire-EDM machine reads it. `G41` offsets the wire to the left of the contour by its radius and the
# side gap to be expected. The contour runs clockwise, so the part stays inside. Any other program or a drawing
# (DXF) is cut in the same way.

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
# These files are what `edmsim cut` leaves as well; `report.html` is the same story on one page, without Python.
#
# ## The report
#
# Everything here came out of the pulse loop. Short shares, kerf, lag and errors are results, never inputs.

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
# - A **short** is a pulse whose voltage never rises: the wire touches, or debris bridges the gap. It is too narrow.
# - An **open** pulse never ignites within its on-time: the gap is too wide.
# - A **spark** ignites after a delay and removes metal.
# - An **arc** ignites at once, on the channel of the pulse before.
#
# Neither short nor open removes anything to speak of, so a machine without any other sensor can steer by these two
# counts alone: faster while pulses stay open, slower when they short. That is what `counts` does. First the wire
# runs through the air of the start hole (all open), then it meets the metal.

# %%
pulses_figure(result.windows)

# %% [markdown]
# The same in the plane of both: a point on the dotted line would mean that no pulse ignites at all. The law
# balances short against open near the lower left, where most pulses work.

# %%
plane_figure(result.windows)

# %% [markdown]
# ## Gap, feed and lag
#
# Feed is what the law commands. The gap is the mean distance across which pulses ignited; the lag is how far the
# wire is bent back against its direction of travel at the workpiece. A negative lag is a wire that runs *ahead* of
# its guides: the discharges push it back, the open voltage pulls it forward, and at this low energy both are of one
# size, so that the lag is small and may have either sign (more of that in notebook 03).

# %%
def per_second(values: np.ndarray) -> np.ndarray:
    """Mean over every second of machine time; NaN (no ignition) left out."""
    second = column(result.windows, "t_s").astype(int)
    known = np.isfinite(values)
    total = np.bincount(second[known], values[known], minlength=second[-1] + 1)
    return total / np.maximum(np.bincount(second[known], minlength=second[-1] + 1), 1)


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
# The error along the edge as drawn, as a coordinate measuring machine would find it: metal left is positive,
# undercut negative. It is drawn large; the bar says how large.

# %%
error_figure(result.scene)

# %% [markdown]
# A corner close up. Guides and wire go round it on an arc, so all that time the part's corner faces the wire, from
# two sides: it is undercut. The lower panel unrolls the edge and shows the wire's deflection beside the error.

# %%
corner_figure(result.scene, result.windows, 0)

# %% [markdown]
# Both walls over the height. Debris gathers at mid-height, where the water from both nozzles comes to rest; it
# makes pulses ignite across wider gaps. The bubbles of the discharges drive most of it out of the gap, so that the
# bulge is slight.

# %%
kerf_figure(report)

# %% [markdown]
# ## Watching it
#
# `cut.rrd` holds the whole cut for the viewer: `edmsim view out/punch` opens it, and without a screen serves it to
# a browser; `edmsim report out/punch --film punch.gif` draws a film. One picture of that film, half way through the
# cut:

# %%
play = Playback(out / "cut.rrd")
figure, axes = plt.subplots(figsize=(9.0, 5.06), dpi=90, layout="constrained")
axes.imshow(Film(play, dpi=70).picture(report["machining_time_s"] / 2))
axes.axis("off")
folder.cleanup()

# %% [markdown]
# ## What it does not tell
#
# One cut is one draw. Most constants of such machines are known within a range only (`Machine.sample`, notebook
# 07), and some of what the model says is contradicted by publications (notebook 08). The slug does not fall, the
# wire is vertical, and roughness is a lower bound.
