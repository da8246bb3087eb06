# ---
# jupyter:
#   edmsim:
#     small: {tensions: [6.0, 18.0], heights_mm: [10.0, 20.0], machines: 2, drawn: 4, seconds: 8.0}
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
# # Tension and height, with uncertainty
#
# **Question.** How do wire tension and workpiece height change the cutting rate, the kerf, the lag of the wire and
# the error at a corner? How much of that applies to a machine whose constants are known only within ranges?
#
# **What is done.** `Machine.sample` draws every constant that has a published range within that range. Each drawn
# machine cuts a straight line and a corner of 90° at every tension and height, under the count law of 1982. Machine
# *k* is the same machine at every point of the grid, so differences between points come from tension and height.
# The figures show the median over the machines, and a band with the middle 80 % of them.

# %% tags=["parameters"]
tensions = [6.0, 9.0, 13.0, 18.0]  # N; the cold wire holds more than twice the highest
heights_mm = [5.0, 15.0, 40.0]
machines = 12  # drawn for every point of the grid
drawn = 60  # drawn for the question which constants matter
seconds = 40.0  # machine time of a straight cut that is measured, once it has settled

# %%
import math
import os
from concurrent.futures import ThreadPoolExecutor
from itertools import product

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import spearmanr

import edmsim
from edmsim.closed_loop.straight import cut_straight
from edmsim.controllers import make
from edmsim.errors import InputError
from edmsim.plant.window import PlantError
from edmsim.recording.figures.palette import BLUE, ORANGE, VERMILION
from edmsim.validation.lag import cut_corner

plt.rcParams.update({"figure.dpi": 90, "axes.spines.top": False, "axes.spines.right": False, "font.size": 9})
MEASURES = ("cutting rate, mm²/min", "kerf, µm", "lag, µm", "corner error, µm")


def cut_both(machine, seed):
    """Cut straight and round a corner; what a broken wire or a jam leaves unknown is NaN."""
    rate = kerf = lag = error = math.nan
    try:
        cut = cut_straight(machine, make("counts"), seed, settle_s=6.0, seconds=seconds)
        if not cut.broken:
            rate, lag = cut.feed_um_s * machine.height_mm * 60e-3, cut.lag_um
            kerf = cut.kerf_um.mean()
        error = cut_corner(machine, seed, feed=make("counts")).farthest_um
    except (PlantError, InputError):  # the wire was driven into the metal; so short a way that no kerf is behind it
        pass
    return rate, kerf, lag, error


def cut_all(jobs):
    """Cut many machines at a time: the compiled loop leaves Python to the other threads."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.array(list(pool.map(lambda job: cut_both(*job), jobs)))


def draw(number, **choices):
    """Return machine `number` with the operator's choices."""
    return edmsim.Machine.load(**choices).sample(np.random.default_rng(number))


# %% [markdown]
# ## Over the grid

# %%
grid = list(product(heights_mm, tensions))
jobs = [(draw(k, height_mm=height, tension=tension), k) for height, tension in grid for k in range(machines)]
found = cut_all(jobs).reshape(len(heights_mm), len(tensions), machines, len(MEASURES))
lost = np.isnan(found[..., 0]).sum()
print(f"{len(jobs)} cuts; {lost} ended by a broken wire or a jam")

# %%
COLOURS = dict(zip(heights_mm, (BLUE, ORANGE, VERMILION), strict=False))
figure, panels = plt.subplots(2, 2, figsize=(8.4, 6.2), sharex=True)
for axes, measure, name in zip(panels.flat, range(len(MEASURES)), MEASURES, strict=True):
    for place, height in enumerate(heights_mm):
        low, middle, high = np.nanquantile(found[place, :, :, measure], [0.1, 0.5, 0.9], axis=1)
        axes.fill_between(tensions, low, high, color=COLOURS[height], alpha=0.16, lw=0)
        axes.plot(tensions, middle, "o-", color=COLOURS[height], ms=4, lw=1.3, label=f"{height:g} mm")
    axes.set_ylabel(name)
figure.legend(*panels[0, 0].get_legend_handles_labels(), frameon=False, ncols=3, loc="upper center")
panels[0, 0].set_ylim(0, None)
panels[1, 0].axhline(0, color="0.8", lw=0.8, zorder=0)
panels[1, 1].set_ylim(0, None)
for axes in panels[1]:
    axes.set_xlabel("wire tension, N")
figure.tight_layout(rect=(0, 0, 1, 0.96))

# %% [markdown]
# The wire lags: at the feed of the count law the discharges and the jets push it back by more than the field between
# wire and workpiece pulls it forward (notebook 03 has slower cuts, where it leads). As for a taut string, the lag
# falls with the tension. From 15 to 40 mm it hardly grows: the higher the workpiece, the smaller is the push of the
# discharges per mm of height, but the pull of the field per mm stays. A wire that lags cuts the corner short; the
# corner error is the distance of its path from that of the guides.
#
# With more tension the wire also vibrates less, so its kerf is narrower, by some 3 µm. The rate hardly depends on
# the tension. The bands of the kerf overlap, because the differences between machines are larger than the effect of
# the tension. On *one* machine the effect is clear, as the comparison of each machine with itself shows:

# %%
print(f"tension {tensions[0]:g} to {tensions[-1]:g} N, each machine compared with itself:")
for measure, name in enumerate(MEASURES):
    for place, height in enumerate(heights_mm):
        first, last = found[place, 0, :, measure], found[place, -1, :, measure]
        both = np.isfinite(first) & np.isfinite(last)
        change = last[both] - first[both]
        print(f"  {name:22} {height:4g} mm high: median change {np.median(change):+7.2f}, "
              f"up on {np.sum(change > 0)} of {both.sum()} machines")

size = np.abs(found[..., 2])
if len(tensions) > 1:
    assert np.nanmedian(size[:, -1]) < np.nanmedian(size[:, 0])  # a taut wire bends less
    assert np.nanmedian(found[:, -1, :, 3]) < np.nanmedian(found[:, 0, :, 3])  # and runs on less beyond a corner

# %% [markdown]
# How much of the spread comes from the machines, and how much from the chance in a single cut? Cuts of the same
# machine with other seeds answer that:

# %%
middle = {"height_mm": heights_mm[len(heights_mm) // 2], "tension": tensions[len(tensions) // 2]}
again = cut_all([(edmsim.Machine.load(**middle), seed) for seed in range(6)])
spread = np.nanstd(found[len(heights_mm) // 2, len(tensions) // 2], axis=0, ddof=1)
for name, machine_sd, seed_sd in zip(MEASURES, spread, np.nanstd(again, axis=0, ddof=1), strict=True):
    print(f"{name:22} standard deviation over machines {machine_sd:6.2f}, over seeds of one machine {seed_sd:5.2f}")

# %% [markdown]
# ## Which constants matter
#
# More machines are drawn at the middle of the grid. The table shows Spearman's rank correlation of every constant
# with every measure. Constants without an effect are left out: their correlation could be chance with this number
# of machines. The level is chosen such that chance adds one constant to the whole table on average.

# %%
sample = [draw(1000 + k, **middle) for k in range(drawn)]
constants = list(sample[0].uncertain())
values = np.array([[machine.uncertain()[name].value for name in constants] for machine in sample])
measured = cut_all([(machine, 7) for machine in sample])


def rank_correlation(x, y):
    """Spearman's correlation and its p over the machines whose cut was finished."""
    known = np.isfinite(y)
    result = spearmanr(x[known], y[known])
    return result.statistic, result.pvalue


table = np.array([[rank_correlation(values[:, c], measured[:, m]) for m in range(len(MEASURES))]
                  for c in range(len(constants))])  # fmt: skip
significant = table[..., 1] < 1 / (len(constants) * len(MEASURES))
shown = np.flatnonzero(significant.any(axis=1))
shown = shown[np.argsort(-np.abs(table[shown, :, 0]).max(axis=1))]
print(f"{len(constants)} uncertain constants, {len(shown)} of them matter for something")

# %%
figure, axes = plt.subplots(figsize=(6.6, 0.8 + 0.32 * max(len(shown), 1)))
image = axes.imshow(table[shown, :, 0], cmap="PuOr", vmin=-1, vmax=1, aspect="auto")
for row, constant in enumerate(shown):
    for column in range(len(MEASURES)):
        value = table[constant, column, 0]
        axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=8,
                  color="white" if abs(value) > 0.7 else "black",
                  weight="bold" if significant[constant, column] else "normal")
axes.set_xticks(range(len(MEASURES)), [name.split(",")[0] for name in MEASURES])
axes.set_yticks(range(len(shown)), [constants[c] for c in shown])
axes.tick_params(length=0)
for side in ("left", "bottom"):
    axes.spines[side].set_visible(False)
figure.colorbar(image, label="rank correlation", shrink=0.9)
figure.tight_layout()

# %% [markdown]
# To predict a machine of your own, find these few constants first. You can measure the clearance of the guides with
# a ruler, and fit others to a log (notebook 09). For the rest the middle of the range is good enough.
#
# ## Limits
#
# - The bands come from the published ranges of the constants, drawn independently of each other. They contain
#   neither the errors of the model itself (notebook 08) nor constants without a range.
# - All cuts here are at the resolution `fast`; what a finer one changes is on the page "convergence".
# - The corner error here concerns the wire's path. The edge of a part also depends on the offset, and on which side
#   of the path the part is (notebook 03).
