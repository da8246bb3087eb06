"""How well a recurrent network estimates a machine's constants from the machine's measurements.

python docs/make/recoverable.py out/histories      # table and picture of tasks/max-rate-shift.md; half an hour

First it records histories of `MACHINES` training machines of MaxRateShift, each cut for ten minutes at a heat flux
that rises until a wire breaks; after an interruption the same command resumes. An LSTM reads a history second by
second and estimates every constant. It learns from some machines and is tested on others, in `FOLDS` parts, by the
share of the variance that it explains. Needs the extra `rl` (torch).
"""

import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import torch
from sections import DOCS, table, write_sections

from edmsim.controllers import from_text
from edmsim.controllers.protocols import FeedCommand, set_up_controller
from edmsim.envs.episode import Task
from edmsim.envs.gap_servo import target_of
from edmsim.envs.registry import make_family
from edmsim.evaluation.episode import Episode
from edmsim.files import replacing
from edmsim.learning.policy_controller import PolicyController
from edmsim.recording.figures.palette import BLUE, MUTED
from edmsim.runs import Processes, perform

FOLDS, CELLS, RATE, DECAY = 5, 24, 5e-3, 1e-2
LIMIT_EPOCHS, EPOCHS = 200, 60
"""Epochs of the network for the limit alone, and of the one for all drawn constants."""
SHORTED = 0.25  # breaks with a greater share of shorts do not count for the flux that breaks the wire
AFTER_S = 10, 60, 240, 600
ENV_ID, ENVIRONMENT = "edmsim/MaxRateShift-v0", {"decision_s": 1.0, "history": 1}
FAMILY = make_family(ENV_ID, **ENVIRONMENT)
MACHINES, FIRST_SEED, SECONDS = 96, 10_000, 600.0
LAW = "heat-flux:shortest_us=12.5,recovery_s=0.5,retract_feed_um_s=80"
LOW, HIGH = 0.04, 2.0  # fluxes of actions -1 and 1, over the critical one; the logarithm is linear in the action
MOST_TARGET = 0.3  # set-point of the open share at an action of 1; it is 0 at -1
BREAK_S = 0.1  # time constant of the flux at a break (ours: a wire breaks some 20 ms after boiling dry)
MEASURED = "held", "flux", "broke_flux"
"""Logarithms of the flux that the law held, of the step's mean of the greatest local flux, and of the flux at which
the last wire broke (0 if none did); fluxes are over the critical one."""
NAMES = [*(entry.name for entry in FAMILY.entries()), *MEASURED]
AT = {name: k for k, name in enumerate(NAMES)}
SHORT, SPENT, LOST, BROKE = (NAMES.index(name) for name in ("short", "spent", "wires_lost", "broke_flux"))
SHOWN_BEFORE = "tension", "height_mm", "flushing_lower_Pa", "flushing_upper_Pa"
"""Drawn values that an operator knows."""
LIMIT = "flux that breaks the wire"
RESAMPLES = 1000


class Climber:
    """A policy whose flux rises every second until a wire breaks, then starts lower and rises slower; with dither."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.card = SimpleNamespace(residual=None)
        self.rows: list[np.ndarray] = []
        self._hold, self._pace = self._rng.uniform(-2.8, -0.7), math.exp(self._rng.uniform(-5.5, -3.2))
        self._dither, self._target, self._lost = 0.0, self._rng.uniform(0, 0.25), 0.0

    def family(self):
        """Return the environment for which observations and decisions are made."""
        return FAMILY

    def fresh_memory(self) -> np.ndarray:
        """Return an empty memory."""
        return np.zeros((2, 0))

    def act(self, observation: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Store observation and decision; the target changes at random times."""
        if observation[AT["wires_lost"]] > self._lost:
            self._lost = observation[AT["wires_lost"]]
            self._hold += math.log(self._rng.uniform(0.6, 0.95))
            self._pace *= self._rng.uniform(0.3, 1.0)
        self._hold = min(self._hold + self._pace, math.log(HIGH))
        self._dither = 0.9 * self._dither + 0.035 * self._rng.normal()
        if self._rng.random() < 0.02:
            self._target = self._rng.uniform(0, 0.25)
        hold = min(max(math.exp(self._hold + self._dither), LOW), HIGH)
        self.rows.append(np.append(observation, (math.log(hold), self._target)))
        return np.array([2.0 * self._target / MOST_TARGET - 1.0, action_of(math.log(hold))]), memory


def action_of(log_hold):
    """Return the action -1..1 for the logarithm of a flux to hold."""
    return 2.0 * (log_hold - math.log(LOW)) / math.log(HIGH / LOW) - 1.0


class Recorder(PolicyController):
    """Cuts with `LAW`; a climber observes the measured fluxes and sets the law's flux and target after every step."""

    def __init__(self, climber: Climber) -> None:
        super().__init__(climber)
        self._law = from_text(LAW)
        self._command_now, self._now_us = FeedCommand(0.0), (0.0, 0.0)

    def set_up(self, machine, points_um, start_um) -> None:
        """Set the machine and the path."""
        super().set_up(machine, points_um, start_um)
        set_up_controller(self._law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg."""
        self._step_s = self._flux_s = self._flux = 0.0
        self._target, self._measured = None, np.zeros(len(MEASURED))
        self._command_now = self._law.reset(max_feed_um_s)
        return super().reset(max_feed_um_s)

    def update(self, window) -> FeedCommand:
        """Return the law's command; at the end of a step, call the climber."""
        self._look(window)
        if self._target is not None:
            self._law.measure.open_target_share = self._target
        self._command_now = self._law.update(window)
        greatest = float(self._law.gauge.flux.max())
        self._flux -= math.expm1(-window.duration_s / BREAK_S) * (greatest - self._flux)
        self._step_s += window.duration_s
        self._flux_s += greatest * window.duration_s
        if self._builder.sums[0]["duration_ns"] >= round(FAMILY.decision_s * 1e9):
            self._end_step()
            self._decide()
        return self._command()

    def wire_lost(self) -> FeedCommand:
        """Store the flux at which the wire broke, and begin with the next."""
        self._measured[-1], self._flux = logarithm(self._flux), 0.0
        self._command_now = self._law.wire_lost()
        return super().wire_lost()

    @property
    def observation(self) -> np.ndarray:
        """The machine's measurements, and the law's fluxes."""
        return np.concatenate([super().observation, self._measured]).astype(np.float32)

    @property
    def _setting_us(self) -> tuple[float, float]:
        return self._now_us  # making a new machine for every window's period would take most of the time

    @_setting_us.setter
    def _setting_us(self, setting_us: tuple[float, float]) -> None:
        self._now_us = setting_us

    def _end_step(self) -> None:
        super()._end_step()
        mean = self._flux_s / self._step_s if self._step_s else 0.0
        self._measured[:2] = logarithm(self._law.period.hold), logarithm(mean)
        self._step_s = self._flux_s = 0.0

    def _decide(self) -> None:
        action, self._memory = self.policy.act(self.observation, self._memory)
        self._target = float(target_of(action[0], FAMILY.servo_target_share))
        self._law.period.hold = LOW * (HIGH / LOW) ** (0.5 * (float(action[1]) + 1.0))

    def _command(self) -> FeedCommand:
        command, (on_us, period_us) = self._command_now, self._now_us
        self._now_us = command.t_on_us or on_us, command.t_period_us or period_us
        return command


def logarithm(flux: float) -> float:
    """Return the logarithm of a flux, within -4..4."""
    return math.log(min(max(flux, math.exp(-4.0)), math.exp(4.0)))


def record(file: Path) -> None:
    """Cut the training machine of the seed in the file's name; save observations, decisions (n, 2), and constants."""
    seed = int(file.stem)
    task, climber = Task(ENV_ID, test_s=0.0), Climber(seed)
    for window in Episode(task, Recorder(climber), seed, "climber").windows():
        if window.observation.time_s >= SECONDS:
            break
    drawn = {name: value for name, value in task.scenario.drawn.items() if not isinstance(value, str)}
    rows = np.array(climber.rows[:-1], np.float32)  # the last decision had no effect
    arrays = {"rows": rows, "names": np.array(list(drawn)), "constants": np.array(list(drawn.values()))}
    with replacing(file) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


class Cut(NamedTuple):
    """A history: observations (n, entries), time (n,), and steps in which a wire broke by heat."""

    shown: np.ndarray
    time_s: np.ndarray
    broke: np.ndarray

    @property
    def broke_s(self) -> float:
        """Time when the first wire broke; infinite if none did."""
        return float(self.time_s[self.broke[0]]) if len(self.broke) else math.inf


def load(folder: Path) -> tuple[list[Cut], dict[str, np.ndarray]]:
    """Return histories, and their constants by name; the limit is the median flux of the breaks, or NaN."""
    cuts, constants, limits = [], [], []
    for file in sorted(folder.glob("*.npz"), key=lambda one: one.stem):
        if not file.stem.isdigit():
            continue
        stored = np.load(file)
        rows = stored["rows"][:, : len(NAMES)].astype(float)
        broke = np.flatnonzero((np.diff(rows[:, LOST]) > 0) & (rows[1:, SHORT] < SHORTED)) + 1
        time_s = rows[:, SPENT] * FAMILY.episode_s
        cuts.append(Cut(rows, time_s, broke))
        limits.append(np.median(rows[broke, BROKE]) if len(broke) else math.nan)
        constants.append(dict(zip(stored["names"].tolist(), stored["constants"].tolist(), strict=True)))
    drawn = {name: np.array([one[name] for one in constants]) for name in constants[0] if name not in SHOWN_BEFORE}
    return cuts, {LIMIT: np.array(limits), **drawn}


def fitted(
    cuts: list[Cut], targets: np.ndarray, epochs: int
) -> tuple[torch.nn.Module, torch.nn.Module, np.ndarray, np.ndarray]:
    """Return an LSTM, its output layer, and the normalisation of its inputs; targets (n, k) may be NaN."""
    torch.manual_seed(0)
    everything = np.concatenate([one.shown for one in cuts])
    mean, std = everything.mean(axis=0), everything.std(axis=0) + 1e-6
    lstm = torch.nn.LSTM(len(mean), CELLS, batch_first=True)
    out = torch.nn.Sequential(torch.nn.Dropout(0.3), torch.nn.Linear(CELLS, targets.shape[1]))
    optimiser = torch.optim.AdamW([*lstm.parameters(), *out.parameters()], RATE, weight_decay=DECAY)
    shown, there = padded(cuts, mean, std)
    target = torch.tensor(np.nan_to_num(targets)).float()[:, None]
    weight = there[..., None] * torch.tensor(np.isfinite(targets)).float()[:, None]
    for _ in range(epochs):
        loss = (weight * (out(lstm(shown)[0]) - target) ** 2).sum() / weight.sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return lstm, out.eval(), mean, std


def padded(cuts: list[Cut], mean: np.ndarray, std: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """Return normalised inputs (n, steps, entries), and 1 where there is a step."""
    steps = max(len(one.shown) for one in cuts)
    shown, there = np.zeros((len(cuts), steps, len(mean))), np.zeros((len(cuts), steps))
    for row, mask, one in zip(shown, there, cuts, strict=True):
        row[: len(one.shown)], mask[: len(one.shown)] = np.clip((one.shown - mean) / std, -5, 5), 1.0
    return torch.tensor(shown).float(), torch.tensor(there).float()


def predicted(cuts: list[Cut], targets: np.ndarray, epochs: int) -> dict[str, np.ndarray]:
    """Return estimates at some times and at the first break, by networks that have not learned from the machine."""
    moments = [*(f"{seconds} s" for seconds in AFTER_S), "first break"]
    said = {moment: np.full(targets.shape, np.nan) for moment in moments}
    for fold in range(FOLDS):
        others = [k for k in range(len(cuts)) if k % FOLDS != fold]
        these = [k for k in range(len(cuts)) if k % FOLDS == fold]
        lstm, out, mean, std = fitted([cuts[k] for k in others], targets[others], epochs)
        with torch.no_grad():
            values = out(lstm(padded([cuts[k] for k in these], mean, std)[0])[0]).numpy()
        for value, k in zip(values, these, strict=True):
            for moment, until in zip(moments, (*AFTER_S, cuts[k].broke_s), strict=True):
                if math.isfinite(until):
                    said[moment][k] = value[min(int(np.searchsorted(cuts[k].time_s, until)), len(cuts[k].shown) - 1)]
    return said


def by_first_break(cuts: list[Cut]) -> tuple[float, float, float, int]:
    """Return `explained` for the flux of the first break as prediction of the median flux of the later ones."""
    fluxes = [one.shown[one.broke, BROKE] for one in cuts if len(one.broke) > 1]
    return explained(np.array([np.median(row[1:]) for row in fluxes]), np.array([row[0] for row in fluxes]))


def explained(target: np.ndarray, said: np.ndarray) -> tuple[float, float, float, int]:
    """Return R2 with its 95 % interval over machines, and their number; variance is about these machines' mean."""
    known = np.isfinite(target) & np.isfinite(said)
    target, said = target[known], said[known]
    rng = np.random.default_rng(0)

    def share(chosen: np.ndarray) -> float:
        there = target[chosen]
        return float(1 - ((there - said[chosen]) ** 2).sum() / max(((there - there.mean()) ** 2).sum(), 1e-12))

    draws = [share(rng.integers(len(target), size=len(target))) for _ in range(RESAMPLES)]
    return share(np.arange(len(target))), *np.percentile(draws, [2.5, 97.5]).tolist(), len(target)


def main() -> None:
    """Record missing histories, fit, write the table into the page of MaxRateShift, and draw."""
    torch.set_num_threads(1)
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{FIRST_SEED + k}.npz" for k in range(MACHINES)]
    missing = [file for file in files if not file.exists()]
    if missing:
        perform(record, missing, lambda done, all_: print(done, "of", all_, flush=True), engine=Processes())
    cuts, constants = load(folder)
    raw = np.stack(list(constants.values()), axis=1)
    targets = (raw - np.nanmean(raw, axis=0)) / (np.nanstd(raw, axis=0) + 1e-12)
    limit, others = predicted(cuts, targets[:, :1], LIMIT_EPOCHS), predicted(cuts, targets[:, 1:], EPOCHS)
    said = {moment: np.hstack([limit[moment], others[moment]]) for moment in limit}
    found = {
        name: {moment: explained(targets[:, k], values[:, k]) for moment, values in said.items()}
        for k, name in enumerate(constants)
    }
    last = f"{AFTER_S[-1]} s"
    order = sorted(found, key=lambda name: -max(found[name][last][0], -9))
    certain = [name for name in order if name == LIMIT or any(share[1] > 0 for share in found[name].values())]
    rows = [
        [name if name == LIMIT else f"`{name}`",
         *(f"{value:.2f} ({low:.2f} to {high:.2f})" for value, low, high, _ in found[name].values())]
        for name in certain
    ]  # fmt: skip
    value, low, high, count = by_first_break(cuts)
    empty = [""] * len(AFTER_S)
    rows.append([f"{LIMIT}, from the first break alone", *empty, f"{value:.2f} ({low:.2f} to {high:.2f})"])
    with_break = sum(math.isfinite(one.broke_s) for one in cuts)
    machines = f"{len(cuts)} machines, each judged by a network that learned from others"
    text = (
        f"{machines}; a wire broke by its heat on {with_break}. The other {len(found) - len(certain)} of "
        f"{len(found)} constants are not identified: the interval of R2 reaches 0 at every time. The last row is "
        f"the prediction of the median of the later breaks, on the {count} machines with several."
    )
    shown = table(["constant", *(f"after {moment}" for moment in said)], rows)
    write_sections("tasks/max-rate-shift.md", {"recoverable": f"{shown}\n\n{text}"})
    draw({name: [share[0] for share in found[name].values()] for name in certain}, list(said))


def draw(shares: dict[str, list[float]], moments: list[str]) -> None:
    """Draw the explained shares of the variance."""
    figure, axes = plt.subplots(figsize=(6.4, 1.4 + 0.35 * len(shares)))
    places = np.arange(len(shares))[::-1]
    for k, moment in enumerate(moments):
        color = BLUE if moment == "first break" else MUTED
        fill = color if k >= len(moments) - 2 else "none"
        values = np.maximum([row[k] for row in shares.values()], -0.2)  # clamped to the edge
        look = {"edgecolors": color, "facecolors": fill, "zorder": 3}
        axes.scatter(values, places, 18 + 14 * k, label=f"after {moment}", **look)
    axes.set_yticks(places, list(shares), fontsize=8)
    axes.axvline(0, color="0.6", lw=0.8)
    axes.set_xlim(-0.25, 1.0)
    axes.set_ylim(-0.6, len(shares) - 0.4)
    axes.set_xlabel("share of the variance between machines that is recovered, R2")
    axes.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(DOCS / "recoverable.png", dpi=110)


if __name__ == "__main__":
    from recoverable import main as run  # because other processes import functions by module

    run()
