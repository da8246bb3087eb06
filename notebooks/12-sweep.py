# ---
# jupyter:
#   edmsim:
#     small: {samples: 2}
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
# # A sweep of settings
#
# **Question.** Which of on-time, period, tension and size of debris matters for the rate, roughness and error of a
# small punch? Which settings are the best compromises?
#
# **What is done.** `edmsim.sweep` cuts a whole punch of 1 x 1 mm at every point of a Sobol sample of the four. The
# size of the debris is drawn within its range: it is not an operator's setting, but it may hide the effect of the
# others. The results are read back as a table, like those of `edmsim sweep`.

# %% tags=["parameters"]
samples = 32  # points, a power of 2
seconds = None  # machine time after which a cut stops; None cuts the whole punch

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from edmsim.recording.figures.palette import BLUE, MUTED, VERMILION
from edmsim.sweep.run import read, sweep
from edmsim.sweep.specification import Specification
from edmsim.sweep.summary import front_of, sensitivities

plt.rcParams.update({"figure.dpi": 90, "axes.spines.top": False, "axes.spines.right": False, "font.size": 9})
PUNCH = "G21 G90\nG0 X-2.5 Y0.5\nG41 D1\nG1 X0 Y0.5\nY1\nX1\nY0\nX0\nY0.5\nG40\nM2\n"

# %%
folder = Path(tempfile.mkdtemp())
(folder / "punch.ngc").write_text(PUNCH)
specification = Specification(
    program=str(folder / "punch.ngc"),
    settings={"resolution": "fast", "height_mm": 30.0, "max_time_s": seconds},
    sobol={
        "samples": samples,
        "ranges": {"t_on_us": [10, 30], "t_period_us": [100, 300], "tension": [8, 16], "gap.particle_share": "range"},
    },
)
done = sweep(specification, folder / "results")
table = read(folder / "results")
print(f"{done.total} runs, {done.failed} failed")

# %% [markdown]
# The same call a second time makes no new runs, because every run is identified by the settings that affect its
# result.

# %%
print(sweep(specification, folder / "results").made, "runs made")

# %% [markdown]
# ## Sensitivity
#
# A bar is the share of a result's variance caused by a setting: dark alone (first-order index), pale with its
# interactions (total index). The result rises with settings of blue bars, and falls with those of red bars. The
# shares come from a polynomial that is fitted to the points; its error at points left out of the fit is the
# unexplained share. With 32 points only strong effects are found: the on-time determines Ra, and on-time and period
# determine the rate. The polynomial explains nothing of the profile error.

# %%
found = sensitivities(table)
names = {"cutting_rate_mm2_min": "cutting rate", "ra_um": "Ra", "error_rms_um": "profile error"}
fig, axes = plt.subplots(1, len(names), figsize=(8.5, 2.4), sharey=True)
for axis, (name, label) in zip(axes, names.items(), strict=True):
    if name in found:
        effects, unexplained = found[name].effects, found[name].unexplained
        colours = [BLUE if effect.rank_correlation > 0 else VERMILION for effect in effects.values()]
        axis.barh(list(effects), [effect.total for effect in effects.values()], color=colours, alpha=0.4)
        axis.barh(list(effects), [effect.first_order for effect in effects.values()], color=colours)
        axis.barh(["unexplained"], [unexplained], color=MUTED)
    axis.set(xlim=(0, 1), title=label, xlabel="share of the variance")
fig.tight_layout()

# %% [markdown]
# ## The best compromises
#
# Each point is one set of settings. For a point with a ring no other is better in one of rate, roughness and error
# without being worse in another: these points form the Pareto front. Its fastest points have long on-times and short
# periods, its smoothest ones short on-times.

# %%
groups, front = front_of(table)
fig, axis = plt.subplots(figsize=(5.5, 3.2))
if groups and set(names) <= set(groups[0].figures):  # a cut that does not come to its end has no error
    rate, ra, error = (np.array([group.figures[name].value for group in groups]) for name in names)
    dots = axis.scatter(rate, ra, c=error, cmap="viridis_r", s=24)
    axis.scatter(rate[front], ra[front], s=70, facecolors="none", edgecolors=VERMILION)
    fig.colorbar(dots, label="profile error, µm rms")
axis.set(xlabel="cutting rate, mm²/min", ylabel="Ra, µm")
fig.tight_layout()
