"""Find out how far a wire lags and cut a sharp corner: a student with memory learns from a teacher who sees the wire.

python examples/learning/corner.py --machines 600 --epochs 60 --seed 1 --out out/corner
edmsim evaluate edmsim/Corner-v2 --controllers policy:out/corner/policy.json

No machine shows how far its wire lags behind the guides. But it can ask: where the pulses become weak for a moment,
the wire springs forward, and the pulses of that moment, and of the next, tell how far. The student is an LSTM that
sets all the environment's actions ten times a second. Three steps:

1. `record` cuts the corner on each of many training machines. `schedule` sets target and pulses: fast on the way,
   weak pulses twice before the corner, a wider gap near it. The teacher, who sees the wire, offsets the guides.
2. `Student` learns from all these cuts which offset would have brought the wire onto the path.
3. With the student's own offsets in place of the teacher's, other machines are cut, and it learns from all of them
   (Ross et al., "A reduction of imitation learning and structured prediction to no-regret online learning", 2011).

An interrupted recording goes on with the same command. Needs the extra `rl` (torch).
"""

from __future__ import annotations

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
from edmsim.learning.policy_controller import PolicyController
from edmsim.learning.policy_file import write_policy

ENV_ID, FIRST_SEED = "edmsim/Corner-v2", 20_000
ENVIRONMENT = {"decision_s": 0.1, "history": 1}
FAMILY = make_family(ENV_ID, **ENVIRONMENT)
NAMES = [entry.name for entry in FAMILY.entries()]
AT = {name: k for k, name in enumerate(NAMES)}
OFFSET_UM = FAMILY.offset_um
PROBES_UM = ((200.0, 10.0), (140.0, 10.0))  # path to the corner at which pulses become weak, and for how long
WEAK = (-0.95, 0.99)  # actions on on-time and duty factor: 8 us every 105 us, a quarter of the power
FAR, NEAR, WEAK_TARGET = 0.03, 0.15, 0.2  # shares of open pulses that the servo holds
NEAR_UM = (15.0, 100.0)  # path before and after the corner on which it holds the wider gap
LAG_UM, FADE_UM = (5.0, 5.0), (15.0, 70.0)  # lags and fades by chance: mean and deviation, least and most
ENOUGH_UM = 420.0  # of the path: behind that no error counts


def schedule(observation: np.ndarray) -> np.ndarray:
    """Return target, on-time and duty factor, -1 to 1 each, at a place before or after the corner."""
    ahead_um, behind_um = 1e3 * observation[AT["corner_ahead"]], 1e3 * observation[AT["corner_behind"]]
    weak = behind_um >= 1e3 and any(at - width < ahead_um <= at for at, width in PROBES_UM)
    near = ahead_um < NEAR_UM[0] or behind_um < NEAR_UM[1]
    target = WEAK_TARGET if weak else NEAR if near else FAR
    low, high = FAMILY.servo_target_share
    return np.array([2.0 * (target - low) / (high - low) - 1.0, *(WEAK if weak else (0.0, 0.0))])


class Recorder:
    """In place of a policy: the schedule, with offsets of a student, or offsets by chance; notes what is seen.

    Chance must not know the wire: a student would learn to read off the pulses what a teacher who knows it has done,
    and then fail by itself.
    """

    def __init__(self, student: Any, seed: int) -> None:
        self.card = SimpleNamespace(hold=None, residual=None)
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
    """Cut a training machine; write observations (n, entries), and of the decisions after them the deflection across
    the second leg, um, and the length cut where errors count, um (both (n,))."""
    task, recorder = Task(ENV_ID), Recorder(student, seed)
    episode, outcome = Episode(task, PolicyController(recorder), seed, "recorder"), None
    leg = task.scenario.legs_um[0]
    along = (leg[2] - leg[1]) / np.hypot(*(leg[2] - leg[1]))
    left = np.array([-along[1], along[0]])
    sums: list[list[float]] = []  # deflection times duration, duration, length
    while outcome is None and task.path_um < ENOUGH_UM:
        decision = len(recorder.rows) - 1
        outcome = episode.step()
        last = episode.last
        while len(sums) <= decision:
            sums.append([0.0, 0.0, 0.0])
        seconds = last.observation.duration_s
        sums[decision][0] += float(np.dot(last.truth.deflection_um, left)) * seconds
        sums[decision][1] += seconds
        sums[decision][2] += last.progress_um * last.near
    bent_um_s, seconds_, cut_um = np.array(sums, np.float32).T
    rows = np.array(recorder.rows[: len(sums)])
    np.savez_compressed(file, rows=rows, across_um=bent_um_s / seconds_, cut_um=cut_um)


SCALE = {
    "short": (0.03, 0.03), "open": (0.1, 0.2), "spark": (0.85, 0.2), "mean_voltage": (0.08, 0.02),
    "mean_current": (0.8, 0.2), "mean_delay": (0.08, 0.05), "commanded_feed": (0.2, 0.07), "actual_feed": (0.2, 0.07),
    "t_on": (0.49, 0.1), "tension": (0.9, 0.2), "height": (0.8, 0.25), "corner_ahead": (0.15, 0.1),
    "corner_turn": (0.0, 0.5), "corner_behind": (0.05, 0.04), "corner_turned": (0.0, 0.5), "offset": (0.0, 0.2),
}  # fmt: skip
"""About the mean and the deviation of the entries that the student looks at; the others are constant."""
SIGNED = [AT[name] for name in ("corner_turn", "corner_turned", "offset")]
STEP = 0.7616  # output of a cell that is a step: tanh(1)
STEPS_UM = (
    *(("corner_ahead", edge) for at, width in PROBES_UM for edge in (at, at - width)),
    ("corner_ahead", NEAR_UM[0]), ("corner_behind", NEAR_UM[1]),
    *(("corner_behind", edge) for edge in (1.5, 4.0, 7.0, 11.0, 16.0, 23.0, 32.0, 45.0, 60.0, 80.0)),
)  # fmt: skip
"""Places at which a cell of the student's that does not learn turns from -`STEP` to `STEP`: those of the schedule, and
some after the corner, where the offset changes fast."""
BATCH = 32
FLOOR_UM2 = 0.5  # mean square of what no offset removes: steps of 2 um, and the wire's vibration


class Cuts:
    """Recorded cuts, padded to one length: observations (n, steps, entries), deflections and lengths (n, steps)."""

    def __init__(self, files: list[Path]) -> None:
        loaded = []
        for file in files:
            one = np.load(file)
            if one["cut_um"].sum() > 1.0:
                loaded.append([torch.from_numpy(one[name]) for name in ("rows", "across_um", "cut_um")])
        loaded.sort(key=lambda one: len(one[0]))
        pad = torch.nn.utils.rnn.pad_sequence
        self.rows, self.across_um, self.cut_um = (
            pad(list(each), batch_first=True) for each in zip(*loaded, strict=True)
        )
        self.lengths = torch.tensor([len(one[0]) for one in loaded])
        # before the corner no offset is wanted
        self.across_um = self.across_um * (self.rows[..., AT["corner_behind"]] < 1)

    def batch(self, chosen: torch.Tensor, sign: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return some of them, as long as the longest; mirrored for a sign of -1."""
        longest = int(self.lengths[chosen].max())
        rows = self.rows[chosen, :longest].clone()
        rows[..., SIGNED] *= sign
        return rows, sign * self.across_um[chosen, :longest], self.cut_um[chosen, :longest]


class Student(torch.nn.Module):
    """An LSTM with a hidden layer; cells that are steps at places of the path, and the schedule, do not learn."""

    def __init__(self, cells: int, hidden: int) -> None:
        super().__init__()
        self.mean, self.std = torch.zeros(len(NAMES)), torch.full((len(NAMES),), 1e6)
        for name, (mean, std) in SCALE.items():
            self.mean[AT[name]], self.std[AT[name]] = mean, std
        self.cells, self.steps = cells, len(STEPS_UM)
        self.memory = torch.nn.LSTM(len(NAMES), cells + self.steps, batch_first=True)
        self.hidden = torch.nn.Linear(cells + self.steps, hidden)
        self.out = torch.nn.Linear(hidden, 1)
        with torch.no_grad():
            self.memory.bias_hh_l0.zero_()
            self.out.weight.mul_(0.3)
            self._set_steps()
        self.memory.weight_ih_l0.register_hook(self._learns)
        self.memory.weight_hh_l0.register_hook(self._learns)
        self.memory.bias_ih_l0.register_hook(self._learns)
        self.memory.bias_hh_l0.register_hook(lambda gradient: torch.zeros_like(gradient))

    def _gates(self, values: torch.Tensor) -> torch.Tensor:
        """Return the rows of the steps' cells in each of the four gates: (4, steps, ...)."""
        return values.view(4, self.cells + self.steps, *values.shape[1:])[:, self.cells :]

    def _set_steps(self) -> None:
        """Let the last cells be steps: open to the observation, without memory."""
        for values in (self.memory.weight_ih_l0, self.memory.weight_hh_l0, self.memory.bias_ih_l0):
            self._gates(values).zero_()
        bias, weight = self._gates(self.memory.bias_ih_l0), self._gates(self.memory.weight_ih_l0)
        bias[0], bias[1], bias[3] = 20.0, -20.0, 20.0
        for k, (name, edge_um) in enumerate(STEPS_UM):
            at = AT[name]
            weight[2, k, at] = 1e3
            bias[2, k] = -1e3 * (1e-3 * edge_um - self.mean[at]) / self.std[at]

    def _learns(self, gradient: torch.Tensor) -> torch.Tensor:
        gradient = gradient.clone()
        self._gates(gradient).zero_()
        return gradient

    def switches(self) -> tuple[tuple[np.ndarray, float], tuple[np.ndarray, float]]:
        """Return weights of the memory (cells,), and a bias, that are 1 where pulses are weak and 0 elsewhere; the
        same for the wider gap."""
        weak, near, half = np.zeros(self.cells + self.steps), np.zeros(self.cells + self.steps), 0.5 / STEP
        for k in range(len(PROBES_UM)):
            weak[self.cells + 2 * k], weak[self.cells + 2 * k + 1] = -half, half
        first = self.cells + 2 * len(PROBES_UM)
        near[first : first + 2] = -half
        return (weak, 0.0), (near, 1.0)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return offsets in um (n, steps) for observations (n, steps, entries)."""
        seen = ((rows - self.mean) / self.std).clamp(-10, 10)
        return OFFSET_UM * self.out(torch.relu(self.hidden(self.memory(seen)[0])))[..., 0]


def rms_um(offset_um: torch.Tensor, across_um: torch.Tensor, cut_um: torch.Tensor) -> torch.Tensor:
    """Return the error of each cut, as the environment measures it: of the decisions where errors count."""
    return ((cut_um * (across_um + offset_um) ** 2).sum(dim=1) / cut_um.sum(dim=1).clamp(min=1.0) + FLOOR_UM2).sqrt()


def taught(cuts: Cuts, epochs: int, cells: int = 40, hidden: int = 64, held: Cuts | None = None) -> Student:
    """Return a student who has learned from cuts; with others that are held, say how well it does there."""
    student = Student(cells, hidden)
    optimiser = torch.optim.Adam(student.parameters(), lr=4e-3)
    schedule_ = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs, 5e-5)
    for epoch in range(1, epochs + 1):
        total = 0.0
        batches = torch.arange(len(cuts.lengths)).split(BATCH)  # of similar lengths
        for k in torch.randperm(len(batches)).tolist():
            rows, across_um, cut_um = cuts.batch(batches[k], float(1 - 2 * torch.randint(2, ())))
            loss = rms_um(student(rows), across_um, cut_um).mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(student.parameters(), 1.0)
            optimiser.step()
            total += float(loss.detach()) * len(batches[k])
        schedule_.step()
        if epoch % 5 == 0:
            print(f"{epoch} epochs: {total / len(cuts.lengths):.2f} um{said(student, held)}", flush=True)
    return student


def said(student: Student, held: Cuts | None) -> str:
    """Return what the student's error is on cuts it has not learned from, as text."""
    if held is None:
        return ""
    with torch.no_grad():
        rows, across_um, cut_um = held.batch(torch.arange(len(held.lengths)))
        with_it, without = (float(rms_um(offset, across_um, cut_um).mean())
                            for offset in (student(rows), torch.zeros_like(across_um)))  # fmt: skip
    return f"; {with_it:.2f} um on others, {without:.2f} without an offset"


def save(student: Student, file: Path, command: str, steps: int, seed: int) -> Any:
    """Write the student, with the schedule, as a policy of edmsim; return it."""
    cell = {name: value.detach().double().numpy() for name, value in student.memory.named_parameters()}
    lstm = cell["weight_ih_l0"].T, cell["weight_hh_l0"].T, cell["bias_ih_l0"] + cell["bias_hh_l0"]
    weak, near = student.switches()
    low, high = FAMILY.servo_target_share
    actions = np.array([[2 * (target - FAR) / (high - low), *pulses, 0.0]
                        for target, pulses in ((WEAK_TARGET, WEAK), (NEAR, (0.0, 0.0)))])  # fmt: skip
    base = np.array([2 * (FAR - low) / (high - low) - 1, 0.0, 0.0, 0.0])
    hidden, out = (
        (one.weight.detach().double().numpy().T, one.bias.detach().double().numpy())
        for one in (student.hidden, student.out)
    )
    count = hidden[0].shape[1]
    weights = np.concatenate([hidden[0], np.stack([weak[0], near[0]], axis=1)], axis=1)
    biases = np.append(hidden[1], (weak[1], near[1]))
    last = np.zeros((count + 2, 4))
    last[:count, 3:], last[count:] = out[0], actions
    base[3] = out[1][0]
    return write_policy(
        file, env_id=ENV_ID, environment=ENVIRONMENT, mean=student.mean.numpy(), variance=student.std.numpy() ** 2,
        lstm=lstm, weights=[weights, last], biases=[biases, base], activation="relu", algorithm="corner",
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
    """Record with the teacher, teach, record with the student, teach, save."""
    parser = argparse.ArgumentParser(description="A student that finds out how far a wire lags, for edmsim/Corner-v2.")
    parser.add_argument("--machines", type=int, default=800, help="training machines, for the teacher and the student")
    parser.add_argument("--epochs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder for recordings and the policy")
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(1)
    count, file = arguments.machines, arguments.out / "policy.json"
    options = f"--machines {count} --epochs {arguments.epochs} --seed {arguments.seed}"
    command = f"python examples/learning/corner.py {options}"
    files = recorded(arguments.out / "teacher", FIRST_SEED, count)
    for _ in range(2):
        held = len(files) // 8
        student = taught(Cuts(files[held:]), arguments.epochs, held=Cuts(files[:held]))
        policy = save(student, file, command, sum(len(np.load(one)["rows"]) for one in files), arguments.seed)
        if len(files) == count:
            files += recorded(arguments.out / "student", FIRST_SEED + count, count, policy)


if __name__ == "__main__":
    main()
