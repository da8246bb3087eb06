# ---
# jupyter:
#   edmsim:
#     small: {runs: 2, interval_mm: 2.0, max_time_s: 20.0}
#   jupytext:
#     formats: ipynb,py:percent
#     notebook_metadata_filter: edmsim,kernelspec,jupytext,-all
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Measure a table, compensate it, cut
#
# **Question.** How much of a worn table's error is left in a part if the control compensates what a laser
# interferometer has measured?
#
# **What is done.** The table of the machine `worn-table` has 12 µm of pitch error between the two sides of a punch
# of 10 x 6 mm, and is out of square by 40 µm in 100 mm. It is measured, its errors are loaded into cam tables
# (ELCAM), and it is measured a second time. Then the punch is cut three times: on a perfect table, on the worn one,
# and on the worn one with compensation. All three cuts use the same random numbers for the sparks.

# %%
# %matplotlib inline
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from IPython.display import display

import edmsim
from edmsim.controllers.axis.elcam.file import load_tables, text_of
from edmsim.measure import measure_table, part_figure, table_figure

# %% tags=["parameters"]
runs = 5  # to every target, from either side
interval_mm = 0.5  # between targets
max_time_s = 3600.0  # machine time after which a cut stops

# %% [markdown]
# ## Measuring
#
# The axis approaches every target several times from below and from above. ISO 230-2 defines accuracy and
# repeatability. While x moves, y is read as well, and its slope is the squareness error. A circle (ISO 230-4) shows
# all errors at once.

# %%
worn = edmsim.Machine.load("worn-table")
before = measure_table(worn, interval_mm=interval_mm, runs=runs, seed=1)
tables = before.tables()
after = measure_table(worn, interval_mm=interval_mm, runs=runs, seed=2, compensation=load_tables(tables))
for name, found in (("as it is", before), ("compensated", after)):
    x, y = (found.along[axis, axis].figures()["accuracy"] for axis in "xy")
    circle = found.circle.figures()["circular_deviation"]
    print(f"{name:12} accuracy A of x {x:5.1f} um, of y {y:5.1f} um; out of square by "
          f"{abs(found.squareness_um_m) / 10:4.1f} um/100 mm; circle {circle:4.1f} um")  # fmt: skip

# %%
measured = {"as it is": before, "compensated": after}
display(table_figure(measured))

# %% [markdown]
# The rest comes from the motor's step of 1 µm, to which every axis, and the compensation, is rounded.
#
# ## Cutting
#
# The next cells are equivalent to these commands: `edmsim measure table --machine worn-table --seed 1 --out
# tables.toml` and `edmsim cut punch.ngc --machine worn-table --compensation tables.toml --height 3 --resolution fast
# --seed 1`.

# %%
folder = Path(tempfile.mkdtemp())
(folder / "tables.toml").write_text(text_of(tables), encoding="utf-8")
(folder / "perfect.toml").write_text(
    'title = "the same without errors"\nlike = "agiecut-dem15"\n'
    '[table]\nstep_um = {value = 1.0, source = "as worn-table"}\n', encoding="utf-8",
)  # fmt: skip
(folder / "punch.ngc").write_text(
    "G21 G90\nG92 X4.0 Y-1.5\nG41 D1 G1 X4.0 Y0.0\nX0.0\nY4.5\nG2 X1.5 Y6.0 I1.5 J0.0\nG1 X4.2\n"
    "G3 X5.8 Y6.0 I0.8 J0.0\nG1 X10.0\nY1.0\nG2 X9.0 Y0.0 I-1.0 J0.0\nG1 X4.0\nG40 G1 Y-1.5\nM02\n",
    encoding="utf-8",
)
cuts = {
    "perfect table": {"machine": str(folder / "perfect.toml")},
    "as it is": {"machine": "worn-table"},
    "compensated": {"machine": "worn-table", "compensation": str(folder / "tables.toml")},
}


def cut(options):
    """Cut the punch from 3 mm of steel: thin, so that it is quick."""
    return edmsim.cut(
        folder / "punch.ngc", height_mm=3.0, resolution="fast", seed=1, max_time_s=max_time_s, **options
    )


with ThreadPoolExecutor(2) as pool:
    results = dict(zip(cuts, pool.map(cut, cuts.values()), strict=True))

# %%
maps = {name: result.scene.maps[0] for name, result in results.items()}
display(part_figure(measured, maps))

# %% [markdown]
# ## Results
#
# A coordinate measuring machine would fit a line to each side of the punch. We do the same, after subtracting the
# error of the perfect table's cut at the same place.

# %%
points = maps["perfect table"].points_mm
x, y = (points - points.min(axis=0)).T
SIDES = {
    "left": (x < 0.01) & (y > 0.3) & (y < 4.2), "right": (x > 9.99) & (y > 1.3) & (y < 5.7),
    "lower": (y < 0.01) & (x > 0.3) & (x < 8.7) & (abs(x - 4.0) > 0.5),
    "upper": (y > 5.99) & (((x > 1.8) & (x < 4.0)) | ((x > 6.0) & (x < 9.7))),
}  # fmt: skip


def lines(name):
    """Return how far out each side stands in um, and how it leans in um per 100 mm."""
    found = {}
    for side, chosen in SIDES.items():
        off = (maps[name].error_um - maps["perfect table"].error_um)[chosen]
        along = (y if side in ("left", "right") else x)[chosen]
        known = np.isfinite(off)
        if known.sum() < 20:
            found[side] = (np.nan, np.nan)
            continue
        slope, middle = np.polyfit(along[known] - along[known].mean(), off[known], 1)
        found[side] = (middle, 100 * slope)
    return found


left = {}
for name in ("as it is", "compensated"):
    found = lines(name)
    width = found["left"][0] + found["right"][0]
    square = (found["upper"][1] - found["lower"][1]) / 2
    left[name] = abs(width), abs(square)
    print(f"{name:12} width off by {width:6.2f} um; lower and upper side lean by {square:6.1f} um/100 mm")
shares = [100 * a / b for a, b in zip(left["compensated"], left["as it is"], strict=True)]
print(f"left: {shares[0]:.1f} % of the pitch error, {shares[1]:.1f} % of the squareness error")
if not np.isnan(shares).any():
    assert max(shares) < 10.0

# %% [markdown]
# The report has these figures as well: the error of the table along the whole edge, the rest after compensation,
# and the profile error that the part would have without compensation.

# %%
report = results["compensated"].report
table = report["table_error_um"]
if report["outcome"] == "finished":
    print(f"table's share: {table['without_um']['rms']:.2f} um rms, left {table['left_um']['rms']:.2f} um rms")
    print(f"profile error: {report['profile_error_um']['rms']:.2f} um rms, without compensation "
          f"{table['profile_without_um']['rms']:.2f} um (worn table, cut: "
          f"{results['as it is'].report['profile_error_um']['rms']:.2f} um)")  # fmt: skip
else:
    print(report["reason"])
