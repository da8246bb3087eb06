# ---
# jupyter:
#   edmsim:
#     small:
#       seeds: [0]
#       tensions: [5.0, 10.0]
#       feeds_um_s: [12.0, 24.0]
#       seconds: 1.0
#       corner_seeds: [0]
#       corner_tensions: [5.0]
#       corner_feeds_um_s: [20.0]
#       remedies: {none: {}, 20 µm beyond: {beyond_um: 20.0}}
#       part_laws: [counts]
#   jupytext:
#     formats: ipynb,py:percent
#     notebook_metadata_filter: edmsim,kernelspec,jupytext,-all
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Wire lag and corner error
#
# **Question.** How far is the wire from its guides, how does that affect a corner, and how well do compensations
# work?

# %%
# %matplotlib inline
import math
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

import edmsim
from edmsim import models
from edmsim.closed_loop.straight import Traverse, begin, cut_straight
from edmsim.geometry import pursuit
from edmsim.metrology.edges import metal_at
from edmsim.plant.plant import Plant
from edmsim.recording.figures.palette import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, SKY, VERMILION
from edmsim.validation.closed_forms import static_lag_um
from edmsim.validation.lag import corner_rig
from edmsim.validation.setups import altered

plt.rcParams.update({"figure.dpi": 90, "figure.constrained_layout.use": True, "axes.grid": True, "grid.alpha": 0.3})

# %% tags=["parameters"]
seeds = [0, 1, 2, 3]
tensions = [4.0, 6.0, 8.0, 10.0, 13.0, 16.0]  # N
feeds_um_s = [8.0, 16.0, 24.0, 32.0]  # of the straight cuts
seconds = 6.0  # machine time every straight cut is looked at
corner_seeds = [0, 1, 2]
corner_tensions = [4.0, 5.0, 6.0, 8.0, 11.0, 16.0]  # of the wire that lags, N
corner_feeds_um_s = [8.0, 12.0, 16.0, 20.0]
remedies = {  # what is done near the corner: arguments of `cut_corner`
    "none": {},
    "half the feed": {"slower": 0.5},
    "less energy": {"energy": 0.75},
    "less energy, half the feed": {"energy": 0.75, "slower": 0.5},
    "10 µm beyond": {"beyond_um": 10.0},
    "20 µm beyond": {"beyond_um": 20.0},
    "30 µm beyond": {"beyond_um": 30.0},
}
part_laws = [  # what the die at the end is cut with
    "counts",
    "counts:open_target_share=0.5",
    "fixed:feed_um_s=20",
    "mcu:corner_um=80,corner_share=0.6",
]

# %% [markdown]
# ## A string
#
# Between its guides the wire is a taut string. A force of `q` per metre over a workpiece of height `h`, the guides
# `L` apart, bends it at mid-height by
#
#     y = q h (2 L - h) / (8 T)
#
# at tension `T`. The model does not use this formula: its modes come from a chain of masses in MuJoCo.

# %%
table = models.published("analytic_static_wire_lag")
figure, axes = plt.subplots(figsize=(6.0, 3.8))
tension = np.linspace(4, 20, 60)
for height, colour in ((10, SKY), (20, BLUE), (30, GREEN), (50, ORANGE), (80, VERMILION)):
    axes.plot(tension, 1e3 * height * (2 * (height + 20) - height) / (8 * tension) * 1e-3, color=colour, lw=1)
    rows = [float(row["T_N"]) for row in table if float(row["h_mm"]) == height]
    axes.plot(rows, [static_lag_um(height, n) for n in rows], "o", color=colour, ms=4, label=f"{height} mm high")
axes.set(xlabel="wire tension, N", ylabel="deflection at mid-height per N/m, µm", yscale="log", ylim=(2, 2000))
axes.legend(title="lines: closed form, dots: model", fontsize=8, ncols=2)
worst = max(
    abs(static_lag_um(float(row["h_mm"]), float(row["T_N"])) / float(row["ymax_um_per_N_per_m"]) - 1) for row in table
)  # fmt: skip
print(f"largest difference from the table: {100 * worst:.2f} %")
assert worst < 0.01

# %% [markdown]
# ## What bends it
#
# Three loads act on the wire in a cut. The gas bubble of every discharge pushes it back. While the open voltage is
# on, the field pulls it forward, towards the metal. In a magnetic metal the current of the discharges also pulls it
# forward, which is negligible at the 7 A of the default set-up. Gas on the wire's front shields push and pull, and
# the film of water damps every motion, but carries no steady load. A negative lag is a wire that *leads*. The
# figure has straight cuts of 20 mm of tool steel with the default set-up, with and without the pull (permittivity
# near zero):

# %%
machine = edmsim.Machine.load(height_mm=20.0)
without_pull = altered(machine, {"base.dielectric.permittivity": 1e-6})


def lags_um(set_up: edmsim.Machine, feed_um_s: float) -> list[float]:
    """Lag of straight cuts, one per seed, side by side: the pulse loop lets other threads run."""
    with ThreadPoolExecutor() as pool:
        cuts = pool.map(lambda seed: cut_straight(set_up, feed_um_s, seed, settle_s=2.0, seconds=seconds), seeds)
        return [cut.lag_um for cut in cuts]


figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.6))
for feed, colour in zip(feeds_um_s, (SKY, BLUE, PURPLE, ORANGE), strict=False):
    lag = np.array([lags_um(machine.with_(tension=n), feed) for n in tensions]).mean(axis=1)
    left.plot(tensions, lag, ".-", color=colour, label=f"{feed:g} µm/s")
    left.plot(tensions, np.mean(lag * tensions) / np.array(tensions), ":", color=colour, lw=1)
left.set(xlabel="wire tension, N", ylabel="lag, µm (negative: the wire leads)")
left.axhline(0, color=INK, lw=0.8)
left.legend(title="dotted: load / tension", fontsize=8)
for set_up, colour, name in ((machine, BLUE, "as it is"), (without_pull, VERMILION, "without the pull")):
    lag = np.array([lags_um(set_up, feed) for feed in feeds_um_s])
    right.errorbar(feeds_um_s, lag.mean(axis=1), lag.std(axis=1), fmt=".-", color=colour, label=name)
right.axhline(0, color=INK, lw=0.8)
right.set(xlabel="feed, µm/s", ylabel="lag, µm")
right.legend();

# %% [markdown]
# The deflection is proportional to 1 / tension, as for a string, if the gap does not change. At this setting push
# and pull are equally large: at a low feed there are few discharges and the pull is larger, at a high feed the
# push. The formula of the pull
# is certain. The impulse of a discharge was never measured, and our derivation has a range of a factor of six,
# enough to change the sign (`docs/theory/emergence.md#lag`). Rough cuts are reported to lag by 10 to 100 µm. So
# this notebook uses both the default machine and a set-up whose wire certainly lags: the rough cut of 11 mJ per
# discharge, 60 mm high, at low tension, in a non-magnetic metal.
#
# ## Round a corner
#
# With a constant lag against the wire's own direction, the wire would follow its guides like a load on a rope: a
# tractrix (`edmsim.geometry`). The loop has no such rule: the force turns with the place of the discharges. So we
# cut a corner of 90 degrees to the left at a fixed feed, and compare the path of the wire, and the metal that it
# left on both sides.

# %%
LEG_UM = 420.0  # travel before and after the corner
REACH_UM = 60.0  # how near to the corner something is done about it


class Corner(NamedTuple):
    """Places of guides and wire, um from the corner, window by window; and the plant with the metal left."""

    guides: np.ndarray
    wire: np.ndarray
    plant: Plant

    @property
    def lag_um(self) -> float:
        straight = (self.guides[:, 0] > -180) & (self.guides[:, 0] < -80)
        return float((self.guides - self.wire)[straight, 0].mean())

    @property
    def nearest_um(self) -> float:
        return float(np.hypot(*smooth(self.wire).T).min())

    def wall_um(self, from_um: tuple[float, float], towards: tuple[float, float]) -> float:
        """Distance from a place to the wall, mean over the height."""
        along = np.arange(0.0, 400.0, 2.0)[:, None] * np.array(towards) / math.hypot(*towards)
        corner = np.add(self.plant.machine.base.table.centre_um, (LEG_UM, 0.0))
        metal = metal_at(self.plant.field, corner + from_um + along)
        return float((1 - metal).sum(axis=1).mean() * 2.0)

    @property
    def outside_um(self) -> float:
        """Error where the part is outside the turn: the wall on the bisector against those of the straights."""
        straight = [(self.wall_um((-s, 0), (0, -1)) + self.wall_um((0, s), (1, 0))) / 2 for s in range(230, 330, 5)]
        return float(np.mean(straight)) - self.wall_um((0, 0), (1, -1))

    @property
    def inside_um(self) -> float:
        """The same where the part is inside the turn, a sharp corner of metal."""
        straight = [(self.wall_um((-s, 0), (0, 1)) + self.wall_um((0, s), (-1, 0))) / 2 for s in range(230, 330, 5)]
        return math.sqrt(2) * float(np.mean(straight)) - self.wall_um((0, 0), (-1, 1))


def cut_corner(
    set_up: edmsim.Machine, seed: int, feed_um_s: float = 20.0, *, slower: float = 1.0, energy: float = 1.0,
    beyond_um: float = 0.0,
) -> Corner:
    """Cut along +x, then +y; near the corner slower, with a shorter on-time, or with guides that run beyond it."""
    plant = begin(set_up, seed)
    drive = Traverse(plant, feed_um_s)
    corner = np.add(set_up.base.table.centre_um, (LEG_UM, 0.0))
    guides, wire = [], []
    for axis, sign, to_um in ((0, 1, beyond_um), (0, -1, 0.0), (1, 1, LEG_UM)):
        drive.axis = axis
        while sign * (plant.commanded_um[axis] - corner[axis] - to_um) < 0:
            near = math.dist(plant.commanded_um, corner) < REACH_UM
            drive.feed_um_s = sign * feed_um_s * (slower if near else 1.0)
            if energy != 1.0:
                plant.set_generator(set_up.t_on_us * (energy if near else 1.0), set_up.t_period_us)
            window = drive.window()
            if window.broken:
                raise RuntimeError(f"the wire broke {math.dist(plant.commanded_um, corner):.0f} um from the corner")
            guides.append(np.subtract(plant.commanded_um, corner))
            wire.append(guides[-1] + window.deflection_um)
    return Corner(np.array(guides), np.array(wire), plant)


def corners(set_up: edmsim.Machine, feed_um_s: float = 20.0, **done: float) -> list[Corner]:
    """Cut a corner once per seed."""
    with ThreadPoolExecutor() as pool:
        return list(pool.map(lambda seed: cut_corner(set_up, seed, feed_um_s, **done), corner_seeds))


def smooth(wire: np.ndarray, travel_um: float = 1.5) -> np.ndarray:
    """Mean over some travel: the wire's vibration is not its path."""
    count = max(1, round(len(wire) * travel_um / (2 * LEG_UM)))
    return np.column_stack([np.convolve(axis, np.full(count, 1 / count), "valid") for axis in wire.T])


lagging = corner_rig(tension=5.0)
plain = {"a wire that lags": corners(lagging), "the default": corners(machine)}
figure, panels = plt.subplots(1, 2, figsize=(10.0, 4.8))
for axes, (name, (one, *_)) in zip(panels, plain.items(), strict=True):
    axes.plot([-100, 0, 0], [0, 0, 100], "--", color=INK, lw=1, label="guides")
    axes.plot(*smooth(one.wire).T, color=BLUE, lw=1.2, label=f"wire, lag {one.lag_um:.1f} µm")
    if one.lag_um > 0:
        axes.plot(*pursuit([(-400, 0), (0, 0), (0, 400)], one.lag_um).T, color=ORANGE, lw=1.2, label="pursuit")
    axes.set(
        xlim=(-80, 30), ylim=(-25, 85), aspect="equal", title=name, xlabel="x from the corner, µm",
        ylabel="y from the corner, µm",
    )  # fmt: skip
    axes.legend(loc="upper left")

# %% [markdown]
# The lagging wire cuts the corner, and returns to the line much later than in the pursuit model: the force turns
# over the scale of the wire, not of the lag, because the outer wall must recede first. A leading wire would
# overshoot the corner by its lead, and also return slowly; the default one hardly does either.
#
# ## What is left of the metal
#
# The error of the part differs from that of the wire. If the part is *outside* the turn (the corner of a die), its
# round wall is compared with the walls of the straights; if it is *inside* (the corner of a punch), its sharp
# corner is. Positive means that metal is left, negative is an undercut.

# %%
by_tension = {n: corners(corner_rig(tension=n)) for n in corner_tensions}
by_feed = {feed: corners(lagging, feed) for feed in corner_feeds_um_s}
by_default = {n: corners(machine.with_(tension=n)) for n in tensions}


def mean(runs: list[Corner], what: str) -> float:
    return float(np.mean([getattr(run, what) for run in runs]))


figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8))
groups = ((by_tension, BLUE, "lags: by tension"), (by_feed, PURPLE, "lags: by feed"), (by_default, GREEN, "default"))
for runs, colour, name in groups:
    lag = [mean(one, "lag_um") for one in runs.values()]
    if runs is not by_default:
        left.plot(lag, [mean(one, "nearest_um") for one in runs.values()], "o", color=colour, label=name)
    right.plot(lag, [mean(one, "outside_um") for one in runs.values()], "o", color=colour, label=f"{name}, outside")
    right.plot(lag, [mean(one, "inside_um") for one in runs.values()], "x", color=colour)
reach = np.array([0.0, mean(by_tension[corner_tensions[0]], "lag_um")])
left.plot(reach, 0.6628 * reach, "-", color=ORANGE, lw=1, label="pursuit: 0.663 lag")
left.set(xlabel="lag, µm", ylabel="nearest approach of the wire to the corner, µm")
right.axhline(0, color=INK, lw=0.8)
right.plot([], [], "x", color=MUTED, label="inside of the turn")
right.set(xlabel="lag, µm", ylabel="error of the metal, µm (+ left, − undercut)")
left.legend(fontsize=8)
right.legend(fontsize=8)
if len(corner_tensions) > 2:
    lag = [mean(one, "lag_um") for one in by_tension.values()]
    slope, offset = np.polyfit(lag, [mean(one, "outside_um") for one in by_tension.values()], 1)
    print(f"outside, over tension: {offset:+.1f} µm and {slope:.2f} µm per µm of lag")

# %% [markdown]
# Outside, lag leaves metal, so more tension helps; a lead would remove as much. But a large part of that error
# occurs without lag: the wall of a straight ignites pulses while the whole wire passes, that of the corner only
# while the wire turns. Inside, a sharp corner is always rounded, since it faces the wire from two sides.
#
# ## Compensation
#
# We compare four remedies within 60 µm of the corner, at otherwise the same feed: half the feed; less energy per
# pulse, the remedy of the 1982 thesis; both; and guides that overshoot the corner and come back before they turn.

# %%
figure, panels = plt.subplots(1, 2, figsize=(10.0, 3.8), sharex=True)
print("set-up                     remedy                       outside, µm    inside, µm   more time, s")
for axes, (name, none), set_up in zip(panels, plain.items(), (lagging, machine), strict=True):
    for row, (remedy, done) in enumerate(remedies.items()):
        runs = corners(set_up, **done) if done else none
        outside, inside = ([getattr(run, side) for run in runs] for side in ("outside_um", "inside_um"))
        longer = np.mean([run.plant.time_ns for run in runs]) - np.mean([run.plant.time_ns for run in none])
        outer = axes.barh(row, np.mean(outside), color=BLUE, height=0.38, xerr=np.std(outside))
        inner = axes.barh(row + 0.4, np.mean(inside), color=ORANGE, height=0.38, xerr=np.std(inside))
        print(f"{name:26} {remedy:28} {np.mean(outside):+11.1f} {np.mean(inside):+13.1f} {longer * 1e-9:14.1f}")
    axes.axvline(0, color=INK, lw=0.8)
    axes.set(title=name, xlabel="error of the metal, µm (+ left, − undercut)")
    axes.set_yticks(np.arange(len(remedies)) + 0.2, list(remedies) if axes is panels[0] else [""] * len(remedies))
    axes.invert_yaxis()
panels[1].legend([outer, inner], ["part outside of the turn", "part inside"], fontsize=8);

# %% [markdown]
# - **Overshoot** is best: every µm reduces the error outside by 0.7 to 0.8 µm, and 10 µm take a second. In the
#   lagging set-up 30 µm are still too few; in the default set-up 10 µm are enough and 20 µm too much. So you must
#   know the right length.
# - **Slower** halves the error, like 5 to 20 µm of overshoot, but takes several times as long: less push, and
#   longer exposure.
# - **Less energy at the same feed makes it worse**, and with half the feed it is worse than half the feed alone.
#   The same metal must be removed per second, by more and weaker sparks across a narrower gap, so the wall stays
#   nearer to the wire.
# - None of them changes the punch's corner inside the turn by more than 1 µm.
#
# ## A die, with controllers as they are
#
# This is a square die opening of 1.2 mm in 20 mm of tool steel, with the part outside. A round kerf leaves $(\sqrt
# 2 - 1)$ of its half width in a sharp corner; more than that is error. The controller of 1982 shortens t(i) from 80
# µm before each corner, and its law finds the feed.

# %%
DIE = """\
G21 G90
G0 X0.6 Y0.6
G41 D1 G1 X0.0 Y0.6
Y0.0
X1.2
Y1.2
X0.0
Y0.6
M2
"""


def cut_die(law: str, seed: int) -> edmsim.CutResult:
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "die.ngc"
        program.write_text(DIE)
        return edmsim.cut(program, controller=law, resolution="fast", seed=seed)


print("law                                  corner error beyond a round kerf, µm     machine time, s")
for law in part_laws:
    with ThreadPoolExecutor() as pool:
        cuts = list(pool.map(cut_die, [law] * len(corner_seeds), corner_seeds))
    round_kerf_um = (math.sqrt(2) - 1) * cuts[0].report["settings"]["offset_um"]
    errors = [[corner["error_um"] - round_kerf_um for corner in cut.report["corners"]] for cut in cuts]
    spread = np.std(np.mean(errors, axis=1)) if len(cuts) > 1 else float("nan")
    seconds_used = np.mean([cut.report["machining_time_s"] for cut in cuts])
    print(f"{law:36} {np.mean(errors):10.1f} ± {spread:<22.1f} {seconds_used:10.0f}")

# %% [markdown]
# A whole cut gives the same result. `counts` cuts at the machine's greatest feed. A slower law, with more open
# pulses or at 20 µm/s, leaves less metal in the corners, but costs time everywhere. The shorter on-time before
# corners alone leaves more.
#
# ## Limits
#
# The result for less energy depends on the impulse per discharge, which was never measured, and on the pull. On a
# machine with much more lag, less energy *with* less feed may gain more. The overshoot was tried only at 90 degrees
# and one feed. This notebook has no taper; the movement of the slug and changes of flushing in a corner are not in
# the model.
