# ---
# jupyter:
#   edmsim:
#     small: {topics: [crater, wire]}
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
# # Validation: the model and publications
#
# **Question.** Where does the model agree with published facts, where does it not, and what can you use it for?
#
# **What is done.** `edmsim.validation` is a list of published facts, each with its source and with code that
# repeats it in the model. A fact is a value, a band or a sign, with a tolerance. Nothing is fitted here. The rows
# below take seconds; `edmsim validate` and the page "validation" also have rows of whole cuts. Rows that fail stay
# in the list, with a link to the reason.

# %% tags=["parameters"]
topics = ["ignition", "crater", "wire", "dielectric", "corner"]

# %%
import math

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown

from edmsim import models, validation
from edmsim.recording.figures.palette import BLUE, INK, MUTED, VERMILION
from edmsim.validation import closed_forms, discharges
from edmsim.validation.report import rows_table, summary

plt.rcParams.update({"figure.dpi": 90, "axes.spines.top": False, "axes.spines.right": False, "font.size": 9})

# %%
rows = validation.run(modules=["discharges", "closed_forms"], topics=topics)
print(summary(rows))
assert not any(row.unexpected for row in rows)  # whatever fails has a page that says why

# %%
COLOURS = {"agree": BLUE, "fail": VERMILION, "do not count": MUTED}


def judged(row: validation.Row) -> str:
    """Return how a row counts, a key of the colours."""
    return "do not count" if row.kind != "judged" else "agree" if row.passed else "fail"


figure, axes = plt.subplots(figsize=(6.4, 0.9 + 0.24 * len(topics)))
left = np.zeros(len(topics))
for how, colour in COLOURS.items():
    count = np.array([sum(judged(row) == how for row in rows if row.topic == topic) for topic in topics])
    axes.barh(topics, count, left=left, color=colour, label=how)
    left += count
axes.invert_yaxis()
axes.set_xlabel("facts compared")
axes.legend(frameon=False)
figure.tight_layout()

# %% [markdown]
# ## All values at a glance
#
# For every fact that is a value the figure shows the model's value divided by the published one, with its 95 %
# interval. Blue points agree, vermilion ones fail, and dark grey ones do not count; the pale bar is the tolerance.
# Bands and signs are not in this figure.

# %%
values = [row for row in rows if row.tolerance.startswith("within")]
of_topic = [topics.index(row.topic) for row in values]
places = np.arange(len(values)) + 4 * np.array(of_topic)  # a space between topics
figure, axes = plt.subplots(figsize=(8.4, 3.4))
for place, row in zip(places, values, strict=True):
    published, within = float(row.published.split()[0]), float(row.tolerance.split()[1]) / 100
    colour = COLOURS[judged(row)]
    axes.plot([place, place], [1 - within, 1 + within], color="0.86", lw=5, solid_capstyle="butt", zorder=1)
    axes.errorbar(place, row.simulated / published, row.uncertainty / published, fmt="o", ms=3.5, color=colour, lw=1)
axes.axhline(1, color="0.6", lw=0.7, zorder=0)
firsts = {row.topic: place for place, row in reversed(list(zip(places, values, strict=True)))}
axes.set_xticks(list(firsts.values()), list(firsts), rotation=45, ha="right")
axes.set(yscale="log", ylabel="model / published")
axes.set_yticks([0.1, 0.2, 0.5, 1, 2], ["0.1", "0.2", "0.5", "1", "2"])
axes.minorticks_off()
figure.tight_layout()

# %% [markdown]
# ## Four topics in detail

# %%
figure, ((ignition, crater), (pull, lag)) = plt.subplots(2, 2, figsize=(8.4, 6.6))

table = models.published("ignition_median_vs_gap_eth")
gaps, medians = (np.array([float(row[key]) for row in table]) for key in ("gap_um", "t50_us"))
held = (gaps >= 5) & (gaps <= 30)
ignition.plot(gaps[held], medians[held], color=INK, lw=1.2, label="published law (ETH)")
for row in rows:
    if row.name.startswith("median delay at"):
        ignition.errorbar(float(row.name.split()[3]), row.simulated, row.uncertainty, fmt="o", ms=4,
                          color=COLOURS[judged(row)])
ignition.axvspan(8, 10, color="0.92", zorder=0, label="two regimes meet (Esteves et al.)")
ignition.set(xlabel="gap, µm", ylabel="median ignition delay, µs", yscale="log", title="ignition")
ignition.legend(frameon=False, fontsize=8)

measured = discharges.published_craters()
crater.errorbar([one.current_A for one in measured], [one.volume for one in measured],
                [one.volume * one.scatter for one in measured], fmt="s", ms=4, color=INK, lw=1, label="ETH")
for row in rows:
    if row.name.startswith("volume at"):
        crater.errorbar(float(row.name.split()[2]), row.simulated, row.uncertainty, fmt="o", ms=4,
                        color=COLOURS[judged(row)])
crater.set(xlabel="current, A", ylabel="volume of a crater, µm³", xscale="log", yscale="log", title="crater")
crater.set_xticks([30, 60, 110, 215, 425], ["30", "60", "110", "215", "425"])
crater.set_yticks([2e3, 5e3, 1e4, 2e4, 5e4], ["2000", "5000", "10 000", "20 000", "50 000"])
crater.minorticks_off()
crater.legend(frameon=False, fontsize=8)

closed = models.published("analytic_electrostatic_force")
for voltage, colour in ((80.0, MUTED), (280.0, INK)):
    force = {float(row["gap_um"]): float(row["force_N_per_m"]) for row in closed if float(row["V"]) == voltage}
    pull.plot(list(force), list(force.values()), "s", ms=5, mfc="none", mec=colour, label=f"{voltage:g} V")
    at = np.linspace(4, 50, 24)
    pull.plot(at, [closed_forms.pull_N_m(gap, voltage) for gap in at], color=BLUE, lw=1)
pull.set(xlabel="gap, µm", ylabel="pull, N/m", yscale="log", title="electrostatic pull (squares: closed form)")
pull.legend(frameon=False, fontsize=8)

string = models.published("analytic_static_wire_lag")
heights = sorted({float(row["h_mm"]) for row in string})
for row in string:
    lag.plot(float(row["T_N"]), float(row["ymax_um_per_N_per_m"]), "s", ms=5, mfc="none", mec=INK)
tensions = sorted({float(row["T_N"]) for row in string})
for height in heights:
    lag.plot(tensions, [closed_forms.static_lag_um(height, tension) for tension in tensions], color=BLUE, lw=1)
    lag.annotate(f"{height:g} mm", (tensions[-1], closed_forms.static_lag_um(height, tensions[-1])), fontsize=8,
                 xytext=(4, 0), textcoords="offset points", va="center")
lag.set(xlabel="tension, N", ylabel="lag at 1 N/m, µm", yscale="log", title="static lag (squares: taut string)")
figure.tight_layout()

for row in string:
    sag_um = closed_forms.static_lag_um(float(row["h_mm"]), float(row["T_N"]))
    assert math.isclose(sag_um, float(row["ymax_um_per_N_per_m"]), rel_tol=0.01)

# %% [markdown]
# - **Ignition.** From 12 µm on the medians lie on the published law. At 8 and 10 µm they are far below it, because
#   two publications of the same group disagree there. The later one (Esteves et al. 2023,
#   [doi:10.3390/jmmp7050177](https://doi.org/10.3390/jmmp7050177)) finds a second, much faster regime below 8 to 10
#   µm, and the model follows it.
# - **Crater.** The model's volume is proportional to the energy. The durations of the measured pulses were not
#   published. One duration for all of them, fitted at 110 A, does not give the steep rise at the highest currents. A
#   duration fitted to each current would make the points agree, but prove nothing.
# - **Pull.** The sum over the rays follows the closed form of a cylinder before a plane within 2 % from 5 to 50 µm.
# - **Lag.** The modes of the wire give the sag of a taut string within 1 %.
#
# ## What fails, and why
#
# The links lead to the pages on the theory.

# %%
failing = [row for row in rows if judged(row) == "fail"]
Markdown("\n".join(rows_table(failing, base="notebooks")))

# %% [markdown]
# If you want to use the model, these differences matter most; most are of whole cuts, and on the page "validation":
#
# - **The lag.** Real wires lag by 10 to 100 µm. A rough cut of 30 mm does so in the model: by 16 µm in tool steel
#   and by 28 µm in austenitic steel. In high workpieces the pull of field and current outweighs the push of the
#   discharges, and the wire leads: by 3 µm in the default cut of 80 mm. The push was derived, never measured, and
#   its range is a factor of six. Trust the changes of the lag with tension and height, but neither its size nor the
#   corner errors that follow.
# - **Production rates.** Production cutting needs four to five times the energy per volume that textbooks give. The
#   model comes near both, because short pulses remove less per joule. That law was chosen from both figures, so the
#   rows of production cutting are a calibration and prove nothing.
# - **Wire rupture.** On 80 mm the model's wire breaks at 27 A; the machine of the publication cut at 29 A. In still
#   water it does not break, but every wire of the publication did. Wires of 0.1 mm cut two to three times as fast
#   before they break as in practice.
# - **Flow.** A stream does not delay the ignition in clean water, and neither flow nor the running wire reduces its
#   vibration.
# - **Walls.** Real walls of 40 mm are concave by 5 to 20 µm in the middle. The model's are straight.
#
# ## All rows

# %%
Markdown("\n".join(rows_table(rows, base="notebooks")))
