"""Cut a sharp corner with a wire that lags: a student with memory finds out how far, and offsets the guides.

python examples/learning/lag.py --machines 400 --rounds 3 --epochs 80 --seed 1 --out out/lag
edmsim evaluate edmsim/Corner-v3 --controllers policy:out/lag/policy.json

No machine shows how far its wire lags behind the guides, and steady pulses say little about it. But rare pulses for a
moment let the wire spring forward, and the pulses of this moment, and of those after it, depend on how far it lagged.
The student, an LSTM, sets all actions of the environment ten times a second. What it learns is the offset; target and
pulses follow `schedule`: rare pulses at the start and twice before the corner, a narrow gap on the way, a wider one
near the corner.

1. `record` cuts the corner on many training machines and notes what is seen, and how far the wire is bent, which the
   student never sees. In the first round the offset is drawn by chance, later it is the student's.
2. `Student` learns from all rounds which offset would have brought the wire onto the path. So it learns in states
   that it reaches itself (DAgger, Ross et al., AISTATS 2011).

An interrupted recording continues with the same command. Needs the extra `rl` (torch).
"""

import argparse
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from edmsim.envs.episode import Task
from edmsim.envs.registry import make_family
from edmsim.evaluation.episode import Episode
from edmsim.files import replacing
from edmsim.learning.policy_controller import PolicyController
from edmsim.learning.policy_file import write_policy

ENV_ID, FIRST_SEED = "edmsim/Corner-v3", 20_000
ENVIRONMENT = {"decision_s": 0.1, "history": 1}
FAMILY = make_family(ENV_ID, **ENVIRONMENT)
NAMES = [entry.name for entry in FAMILY.entries()]
AT = {name: k for k, name in enumerate(NAMES)}
OFFSET_UM = FAMILY.offset_um
PROBES_UM = ((220.0, 20.0), (140.0, 20.0))  # path to the corner at which pulses become rare, and for how long
# the same where every cut begins, 300 um before the corner: close to the metal every pulse ignites, and at the usual
# period a tenth of the wires break before the gap has opened
RARE_UM = ((310.0, 11.0), *PROBES_UM)
USUAL, RARE = (0.0, -0.257), (0.0, 0.743)  # actions on on-time and period: 1.4 us every 50 us, and every 202 us
FAR, NEAR, RARE_TARGET = 0.45, 0.6, 0.6  # shares of open pulses that the servo holds
NEAR_UM = (15.0, 100.0)  # path before and after the corner on which it holds the wider gap
LAG_UM, FADE_UM = (20.0, 12.0), (15.0, 70.0)  # lags and fades by chance: mean and deviation, least and most
ENOUGH_UM = 420.0  # of the path: beyond that no error counts


def schedule(observation: np.ndarray) -> np.ndarray:
    """Return target, on-time and period, -1 to 1 each, at a place before or after the corner."""
    ahead_um, behind_um = 1e3 * observation[AT["corner_ahead"]], 1e3 * observation[AT["corner_behind"]]
    rare = behind_um >= 1e3 and any(at - width < ahead_um <= at for at, width in RARE_UM)
    near = ahead_um < NEAR_UM[0] or behind_um < NEAR_UM[1]
    target = RARE_TARGET if rare else NEAR if near else FAR
    low, high = FAMILY.servo_target_share
    return np.array([2.0 * (target - low) / (high - low) - 1.0, *(RARE if rare else USUAL)])


class Recorder:
    """In place of a policy: a student, or the schedule with an offset drawn by chance; notes what is seen.

    The offset of the true bend must not be used: the pulses show how the gap changes with the offset, so a student
    would learn to infer the bend from the offset of one who knows it, and fail alone.
    """

    def __init__(self, student: Any, seed: int) -> None:
        self.card = SimpleNamespace(residual=None, observation=())
        self.rows: list[np.ndarray] = []
        self._student = student
        rng = np.random.default_rng(seed)
        self._lag_um, self._fade_um = rng.normal(*LAG_UM), rng.uniform(*FADE_UM)

    def family(self):
        """Return the environment whose observations and decisions these are."""
        return FAMILY

    def fresh_memory(self) -> np.ndarray:
        """Return the memory of the student, if there is one."""
        return np.zeros((2, 0)) if self._student is None else self._student.fresh_memory()

    def act(self, observation: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Note what is seen, and decide."""
        self.rows.append(np.array(observation, np.float32))
        if self._student is not None:
            return self._student.act(observation, memory)
        behind_um, turn = 1e3 * observation[AT["corner_behind"]], math.pi * observation[AT["corner_turned"]]
        offset_um = -self._lag_um * math.sin(turn) * math.exp(-behind_um / self._fade_um)
        return np.clip(np.append(schedule(observation), offset_um / OFFSET_UM), -1.0, 1.0), memory


def record(seed: int, file: Path, student: Any = None) -> None:
    """Cut a training machine, and write what is seen and how far the wire is bent.

    That is observations (n, entries), and for the decisions after them, (n,) each in um, the deflections across the
    second leg and against the first one, and the length cut where errors count.
    """
    task, recorder = Task(ENV_ID), Recorder(student, seed)
    episode = Episode(task, PolicyController(recorder), seed, "recorder")
    leg = task.scenario.legs_um[0]
    along = (leg[2] - leg[1]) / np.hypot(*(leg[2] - leg[1]))
    across, lag = np.array([-along[1], along[0]]), (leg[0] - leg[1]) / np.hypot(*(leg[1] - leg[0]))
    sums: list[list[float]] = []  # deflections times duration, duration, length
    decision = len(recorder.rows) - 1  # of the window, which is cut before the next decision
    for window in episode.windows():
        while len(sums) <= decision:
            sums.append([0.0, 0.0, 0.0, 0.0])
        seconds, bent_um = window.observation.duration_s, window.truth.deflection_um
        bent_um_s = [float(np.dot(way, bent_um)) * seconds for way in (across, lag)]
        more = *bent_um_s, seconds, window.progress_um * window.near
        sums[decision] = [before + each for before, each in zip(sums[decision], more, strict=True)]
        decision = len(recorder.rows) - 1
        if task.path_um >= ENOUGH_UM:
            break
    across_um_s, lag_um_s, seconds_, cut_um = np.array(sums, np.float32).T
    rows = np.array(recorder.rows[: len(sums)])
    with replacing(file) as partial, partial.open("wb") as opened:
        np.savez_compressed(
            opened, rows=rows, across_um=across_um_s / seconds_, lag_um=lag_um_s / seconds_, cut_um=cut_um
        )


SCALE = {
    "short": (0.03, 0.05), "open": (0.5, 0.15), "spark": (0.45, 0.15), "mean_voltage": (0.25, 0.08),
    "mean_current": (0.06, 0.025), "mean_delay": (0.2, 0.15), "commanded_feed": (0.2, 0.15),
    "actual_feed": (0.2, 0.15), "t_period": (0.4, 0.1), "tension": (0.9, 0.2), "height": (0.8, 0.25),
    "corner_ahead": (0.15, 0.1), "corner_turn": (0.0, 0.5), "corner_behind": (0.05, 0.04),
    "corner_turned": (0.0, 0.5), "offset": (0.0, 0.2),
}  # fmt: skip
"""Roughly the mean and the deviation of the entries that the student sees; the others are constant."""
SIGNED = [AT[name] for name in ("corner_turn", "corner_turned", "offset")]
STEP = 0.7616  # output of a cell that is a step: tanh(1)
STEPS_UM = (
    *(("corner_ahead", edge) for at, width in RARE_UM for edge in (at, at - width)),
    ("corner_ahead", NEAR_UM[0]), ("corner_behind", NEAR_UM[1]),
    *(("corner_behind", edge) for edge in (1.5, 4.0, 7.0, 11.0, 16.0, 23.0, 32.0, 45.0, 60.0, 80.0)),
)  # fmt: skip
"""Places at which the output of a cell that does not learn changes from -`STEP` to `STEP`: those of the schedule, and
some after the corner, where the offset changes fast."""
BATCH = 32
LAG_WEIGHT = 0.3  # of the error of the lag that the student estimates before the corner, in um, in its loss (ours)
REMEMBER = 2.0  # bias of the forget gates at the start (ours): the corner comes a hundred decisions after the probes
FLOOR_UM2 = 0.5  # mean square error that no offset removes (ours): steps of 2 um, and the wire's vibration


class Cuts:
    """Recorded cuts, padded to one length: observations (n, steps, entries), deflections and lengths (n, steps)."""

    def __init__(self, files: list[Path]) -> None:
        loaded = []
        for file in files:
            one = np.load(file)
            if one["cut_um"].sum() > 1.0:
                loaded.append([torch.from_numpy(one[name]) for name in ("rows", "across_um", "cut_um", "lag_um")])
        loaded.sort(key=lambda one: len(one[0]))
        pad = torch.nn.utils.rnn.pad_sequence
        self.rows, self.across_um, self.cut_um, lag_um = (
            pad(list(each), batch_first=True) for each in zip(*loaded, strict=True)
        )
        ahead = self.rows[..., AT["corner_ahead"]]
        steady = (ahead > 0) & (ahead < 0.1)
        # (n,): how far the wire lags where it comes to the corner
        self.lag_um = (lag_um * steady).sum(dim=1) / steady.sum(dim=1).clamp(min=1)
        self.lengths = torch.tensor([len(one[0]) for one in loaded])
        # before the corner the offset should be 0
        self.across_um = self.across_um * (self.rows[..., AT["corner_behind"]] < 1)

    def batch(self, chosen: torch.Tensor, sign: float = 1.0) -> tuple[torch.Tensor, ...]:
        """Return some of them, as long as the longest; mirrored for a sign of -1."""
        longest = int(self.lengths[chosen].max())
        rows = self.rows[chosen, :longest].clone()
        rows[..., SIGNED] *= sign
        return rows, sign * self.across_um[chosen, :longest], self.cut_um[chosen, :longest], self.lag_um[chosen]


class Student(torch.nn.Module):
    """An LSTM with a hidden layer; some cells are steps at places of the path and do not learn."""

    def __init__(self, cells: int, hidden: int) -> None:
        super().__init__()
        self.mean, self.std = torch.zeros(len(NAMES)), torch.full((len(NAMES),), 1e6)
        for name, (mean, std) in SCALE.items():
            self.mean[AT[name]], self.std[AT[name]] = mean, std
        self.cells, self.steps = cells, len(STEPS_UM)
        self.memory = torch.nn.LSTM(len(NAMES), cells + self.steps, batch_first=True)
        self.hidden = torch.nn.Linear(cells + self.steps, hidden)
        self.out, self.lag = torch.nn.Linear(hidden, 1), torch.nn.Linear(hidden, 1)
        with torch.no_grad():
            self.memory.bias_hh_l0.zero_()
            self.memory.bias_ih_l0.view(4, -1)[1] += REMEMBER
            self.out.weight.mul_(0.3)
            self._set_steps()
        self.memory.weight_ih_l0.register_hook(self._learns)
        self.memory.weight_hh_l0.register_hook(self._learns)
        self.memory.bias_ih_l0.register_hook(self._learns)
        self.memory.bias_hh_l0.register_hook(lambda gradient: torch.zeros_like(gradient))

    def _gates(self, values: torch.Tensor) -> torch.Tensor:
        """Return the rows of the cells that are steps, in each of the four gates: (4, steps, ...)."""
        return values.view(4, self.cells + self.steps, *values.shape[1:])[:, self.cells :]

    def _set_steps(self) -> None:
        """Make the last cells steps: without memory, of one entry of the observation."""
        for values in (self.memory.weight_ih_l0, self.memory.weight_hh_l0, self.memory.bias_ih_l0):
            self._gates(values).zero_()
        bias, weight = self._gates(self.memory.bias_ih_l0), self._gates(self.memory.weight_ih_l0)
        bias[0], bias[1], bias[3] = 20.0, -20.0, 20.0
        for k, (name, edge_um) in enumerate(STEPS_UM):
            at = AT[name]
            weight[2, k, at] = 1e3
            bias[2, k] = -1e3 * (1e-3 * edge_um - self.mean[at]) / self.std[at]

    def _learns(self, gradient: torch.Tensor) -> torch.Tensor:
        """Return a gradient without that of the cells that are steps."""
        gradient = gradient.clone()
        self._gates(gradient).zero_()
        return gradient

    def switches(self) -> tuple[tuple[np.ndarray, float], tuple[np.ndarray, float]]:
        """Return weights (cells,) and bias of a unit that is 1 where pulses are rare; and where the gap is wider."""
        rare, near, half = np.zeros(self.cells + self.steps), np.zeros(self.cells + self.steps), 0.5 / STEP
        for k in range(len(RARE_UM)):
            rare[self.cells + 2 * k], rare[self.cells + 2 * k + 1] = -half, half
        first = self.cells + 2 * len(RARE_UM)
        near[first : first + 2] = -half
        return (rare, 0.0), (near, 1.0)

    def forward(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return offsets and lags in um (n, steps) for observations (n, steps, entries)."""
        inputs = ((rows - self.mean) / self.std).clamp(-10, 10)
        hidden = torch.relu(self.hidden(self.memory(inputs)[0]))
        return OFFSET_UM * self.out(hidden)[..., 0], OFFSET_UM * self.lag(hidden)[..., 0]


def rms_um(offset_um: torch.Tensor, across_um: torch.Tensor, cut_um: torch.Tensor) -> torch.Tensor:
    """Return the error of each cut near the corner, as the environment measures it, and `FLOOR_UM2`."""
    return ((cut_um * (across_um + offset_um) ** 2).sum(dim=1) / cut_um.sum(dim=1).clamp(min=1.0) + FLOOR_UM2).sqrt()


def taught(cuts: Cuts, epochs: int, others: Cuts, cells: int = 40, hidden: int = 64) -> Student:
    """Return a student who has learned from cuts; say now and then how well it does on others."""
    student = Student(cells, hidden)
    optimiser = torch.optim.Adam(student.parameters(), lr=4e-3)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs, 5e-5)
    for epoch in range(1, epochs + 1):
        total = 0.0
        batches = torch.arange(len(cuts.lengths)).split(BATCH)  # of similar lengths
        for k in torch.randperm(len(batches)).tolist():
            rows, across_um, cut_um, lag_um = cuts.batch(batches[k], float(1 - 2 * torch.randint(2, ())))
            offset_um, guess_um = student(rows)
            error_um = rms_um(offset_um, across_um, cut_um).mean()
            ahead = rows[..., AT["corner_ahead"]]
            probed = (ahead > 0) & (ahead < 1e-3 * (PROBES_UM[0][0] - PROBES_UM[0][1]))
            loss = error_um + LAG_WEIGHT * ((guess_um - lag_um[:, None]).abs() * probed).sum() / probed.sum()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(student.parameters(), 1.0)
            optimiser.step()
            total += float(error_um.detach()) * len(batches[k])
        decay.step()
        if epoch % 5 == 0:
            print(f"{epoch} epochs: {total / len(cuts.lengths):.2f} um{said(student, others)}", flush=True)
    return student


def said(student: Student, others: Cuts) -> str:
    """Return the student's errors on cuts that it has not learned from, as text."""
    with torch.no_grad():
        rows, across_um, cut_um, lag_um = others.batch(torch.arange(len(others.lengths)))
        offset_um, guess_um = student(rows)
        with_it, without = (float(rms_um(offset, across_um, cut_um).mean())
                            for offset in (offset_um, torch.zeros_like(across_um)))  # fmt: skip
        at = (rows[..., AT["corner_ahead"]] > 0) & (rows[..., AT["corner_ahead"]] < 0.03)
        last_um = (guess_um * at).sum(dim=1) / at.sum(dim=1).clamp(min=1)
        r2 = 1 - float(((last_um - lag_um) ** 2).sum() / ((lag_um - lag_um.mean()) ** 2).sum())
    return f"; {with_it:.2f} um on others, {without:.2f} without an offset; R2 of the lag {r2:.2f}"


def save(student: Student, file: Path, command: str, steps: int, seed: int) -> Any:
    """Write the student, with the schedule, as a policy of edmsim; return it."""
    cell = {name: value.detach().double().numpy() for name, value in student.memory.named_parameters()}
    lstm = cell["weight_ih_l0"].T, cell["weight_hh_l0"].T, cell["bias_ih_l0"] + cell["bias_hh_l0"]
    rare, near = student.switches()
    low, high = FAMILY.servo_target_share
    actions = np.array([[2 * (target - FAR) / (high - low), *np.subtract(pulses, USUAL), 0.0]
                        for target, pulses in ((RARE_TARGET, RARE), (NEAR, USUAL))])  # fmt: skip
    base = np.array([2 * (FAR - low) / (high - low) - 1, *USUAL, 0.0])
    hidden, out = (
        (one.weight.detach().double().numpy().T, one.bias.detach().double().numpy())
        for one in (student.hidden, student.out)
    )
    count = hidden[0].shape[1]
    weights = np.concatenate([hidden[0], np.stack([rare[0], near[0]], axis=1)], axis=1)
    biases = np.append(hidden[1], (rare[1], near[1]))
    last = np.zeros((count + 2, 4))
    last[:count, 3:], last[count:] = out[0], actions
    base[3] = out[1][0]
    return write_policy(
        file, env_id=ENV_ID, environment=ENVIRONMENT, mean=student.mean.numpy(), variance=student.std.numpy() ** 2,
        lstm=lstm, weights=[weights, last], biases=[biases, base], activation="relu", algorithm="lag",
        command=command, seed=seed, steps=steps,
    )


def recorded(folder: Path, first_seed: int, count: int, student: Any = None) -> list[Path]:
    """Return the files of cuts; those that are missing are made."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{seed}.npz" for seed in range(first_seed, first_seed + count)]
    for k, file in enumerate(files):
        if not file.exists():
            record(first_seed + k, file, student)
            if (k + 1) % 50 == 0:
                print(f"{k + 1} of {count} machines recorded in {folder.name}", flush=True)
    return files


def main() -> None:
    """Record and teach, round by round; save the student of the last one."""
    parser = argparse.ArgumentParser(description="A student that finds out how far a wire lags.")
    parser.add_argument("--machines", type=int, default=400, help="training machines of each round")
    parser.add_argument("--rounds", type=int, default=3, help="the first with offsets by chance, then the student's")
    parser.add_argument("--epochs", type=int, default=80)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder for recordings and policies")
    arguments = parser.parse_args()
    if arguments.machines < 2 or min(arguments.rounds, arguments.epochs) < 1:
        parser.error("give 2 machines or more, one of which tests the student, and 1 round and epoch or more")
    torch.set_num_threads(1)
    count = arguments.machines
    options = f"--machines {count} --rounds {arguments.rounds} --epochs {arguments.epochs} --seed {arguments.seed}"
    command = f"python examples/learning/lag.py {options}"
    files: list[Path] = []
    policy = None
    for k in range(arguments.rounds):
        files += recorded(arguments.out / f"round-{k + 1}", FIRST_SEED + k * count, count, policy)
        torch.manual_seed(arguments.seed)
        others = files[-count // 8 :]
        student = taught(Cuts(files[: -len(others)]), arguments.epochs, Cuts(others))
        last = k + 1 == arguments.rounds
        file = arguments.out / ("policy.json" if last else f"round-{k + 1}.json")
        policy = save(student, file, command, sum(len(np.load(one)["rows"]) for one in files), arguments.seed)


if __name__ == "__main__":
    main()
