"""Adapt to a machine: a student with memory learns what heat flux to hold, from a teacher who knows the machine.

python examples/learning/adapt.py --machines 32 --shifts 30 --seed 1 --out out/adapt
edmsim evaluate edmsim/MaxRateShift-v0 --controllers policy:out/adapt/policy.json,adaptive-hold --seeds 12

What wires bear differs from machine to machine by a factor of ten, and no machine shows it. The law `heat-flux` cuts;
every second the student says what flux the law holds. Three steps:

1. `record` cuts a few minutes on each of many training machines, at fluxes that rise until a wire breaks.
2. `Hazard` is fitted to these histories: at which flux the wires of each machine break, how sharply, and what the
   operator's dials say of it beforehand. Knowing all of a machine's history, it is the teacher.
3. `Student`, an LSTM, runs shifts on thousands of machines drawn from that model, whose true limits it is not shown.
   Its loss is what its hold loses, in the mean, against the best hold of one who knows the limit. So it learns to
   hold less where it cannot know, and to find out (Kumar et al., "RMA: Rapid Motor Adaptation", RSS 2021, learn from
   privileged knowledge alike).

The first step takes nearly all the time, is interrupted at will and goes on. Needs the extra `rl` (torch).

Run once by the first command, in some 170 s of a processor: 4.0 % less than who knows the limit, and 5.1 wires in a
shift of the model; on twelve held-back machines 98 % (94 to 105) of what `adaptive-hold` earns, with 52 lost wires
where that loses 34 (`python docs/make/adapted.py`).
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import torch

from edmsim.envs.episode import Task
from edmsim.envs.registry import make_family
from edmsim.evaluation.episode import Episode
from edmsim.learning.hold_controller import HoldController
from edmsim.learning.policy_file import Hold, write_policy

ENV_ID, FIRST_SEED = "edmsim/MaxRateShift-v0", 10_000
SECONDS = 240.0  # of each training machine
LAW = "heat-flux:shortest_us=12.5,recovery_s=0.5,retract_feed_um_s=80"
HOLD = Hold(law=LAW, low=0.04, high=2.0)
ENVIRONMENT = {"decision_s": 1.0, "history": 1}
MOST_TARGET = 0.3  # open share that the servo holds at an action of 1; 0 at -1
ENTRIES = make_family(ENV_ID, **ENVIRONMENT).entries()
NAMES = [*(entry.name for entry in ENTRIES), "held", "flux", "broke_flux"]
AT = {name: k for k, name in enumerate(NAMES)}
DIALS = "tension", "height", "flushing_lower", "flushing_upper"
FIFTHS = tuple(f"fifth_{k}" for k in range(1, 6))
SHOWN = *DIALS, *FIFTHS, "wires_lost", "wire_age", "spent", "held", "flux", "broke_flux", "short", "open", "t_period"
"""What the student looks at: where along the height pulses ignite says something of the limit beforehand."""
SHORTED = 0.25  # share of shorts from which on a second is not one of cutting
FIRST_S = 40  # in which the first workpiece, the highest, shows how ignitions are distributed
SHIFT_S, TEST_S, THREADING_S, WIRES = 1200, 60, 20.0, 100
RISE_S = 2.0  # of cutting that a fresh wire loses until it is at its period
OPENS = 0.15  # share of open pulses at which a limit is the flux itself
SLOPE = 0.15  # deviation of the slopes beforehand (ours)
LIMITS = torch.linspace(math.log(0.03), math.log(4.0), 120)


# 1. histories of training machines


class Climber:
    """In place of a policy: more flux every second until a wire breaks, then less, and slower; with some dither."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.card = SimpleNamespace(hold=HOLD, residual=None)
        self.rows: list[np.ndarray] = []
        self._hold, self._pace = self._rng.uniform(-2.8, -0.7), math.exp(self._rng.uniform(-5.5, -3.2))
        self._dither, self._target, self._lost = 0.0, self._rng.uniform(0, 0.25), 0.0

    def family(self):
        """Return the environment whose observations and decisions these are."""
        return make_family(ENV_ID, **ENVIRONMENT)

    def fresh_memory(self) -> np.ndarray:
        """Return no memory."""
        return np.zeros((2, 0))

    def act(self, observation: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Note what is seen and decided; the target changes once in a while."""
        if observation[AT["wires_lost"]] > self._lost:
            self._lost = observation[AT["wires_lost"]]
            self._hold += math.log(self._rng.uniform(0.6, 0.95))
            self._pace *= self._rng.uniform(0.3, 1.0)
        self._hold = min(self._hold + self._pace, math.log(HOLD.high))
        self._dither = 0.9 * self._dither + 0.035 * self._rng.normal()
        if self._rng.random() < 0.02:
            self._target = self._rng.uniform(0, 0.25)
        hold = min(max(math.exp(self._hold + self._dither), HOLD.low), HOLD.high)
        self.rows.append(np.append(observation, (math.log(hold), self._target)))
        return np.array([2.0 * self._target / MOST_TARGET - 1.0, action_of(math.log(hold))]), memory


def action_of(log_hold):
    """Return the action -1..1 that asks for a hold, given by its logarithm."""
    return 2.0 * (log_hold - math.log(HOLD.low)) / math.log(HOLD.high / HOLD.low) - 1.0


def record(seed: int, seconds: float, file: Path) -> None:
    """Cut a training machine, and write down decisions (n, entries + 2), area of the steps (n,), and constants."""
    task, climber = Task(ENV_ID, test_s=0.0), Climber(seed)
    episode, areas, area, outcome = Episode(task, HoldController(climber), seed, "climber"), [], 0.0, None
    while outcome is None and (episode.last is None or episode.last.observation.time_s < seconds):
        outcome = episode.step()
        area += episode.last.area_mm2
        while len(areas) < len(climber.rows):
            areas.append(area)
            area = 0.0
    drawn = {name: value for name, value in task.scenario.drawn.items() if not isinstance(value, str)}
    count = len(areas)
    np.savez_compressed(
        file, rows=np.array(climber.rows[:count], np.float32), areas=np.array(areas, np.float32),
        names=np.array(list(drawn)), constants=np.array(list(drawn.values())),
    )


class History(NamedTuple):
    """Steps of a machine: logarithm of the flux, opens, seconds, whether the wire broke; what is known beforehand."""

    flux: torch.Tensor
    opens: torch.Tensor
    seconds: torch.Tensor
    broke: torch.Tensor
    before: np.ndarray


def history_of(file: Path) -> History:
    """Return the steps that a file has."""
    rows = np.load(file)["rows"].astype(float)
    after = rows[1:]
    broke = np.diff(rows[:, AT["wires_lost"]]) > 0.5 / WIRES
    seconds = np.clip(np.diff(rows[:, AT["spent"]]) * SHIFT_S - THREADING_S * broke, 0.01, 1.5)
    flux = np.where(broke, after[:, AT["broke_flux"]], after[:, AT["flux"]])
    broke &= after[:, AT["short"]] < SHORTED  # the others say nothing of the flux that a wire bears
    cutting = after[:FIRST_S][after[:FIRST_S, AT["short"]] < SHORTED]
    before = np.append(rows[0, [AT[name] for name in DIALS]], cutting[:, [AT[name] for name in FIFTHS]].mean(axis=0))
    steps = (torch.tensor(each).float() for each in (flux, after[:, AT["open"]] - OPENS, seconds))
    return History(*steps, torch.tensor(broke), before)


# 2. the teacher


class Hazard:
    """When wires break: exp(steepness (flux - limit)) / 60 per s, and by chance; all fluxes are logarithms.

    Where many pulses stay open those that ignite do so in bursts: a share of opens counts as some more flux.
    A machine's limit is drawn around a linear function of its dials and of where its pulses ignite. All is fitted by
    the likelihood of the histories; slopes are small beforehand, as machines are few.
    """

    def __init__(self, histories: list[History], steps: int = 250) -> None:
        self.before = torch.tensor(np.array([one.before for one in histories])).float()
        self.mean, self.std = self.before.mean(dim=0), self.before.std(dim=0)
        normal = self.normal(self.before)
        count = len(self.mean)
        start = [math.log(0.6), *np.zeros(count), 0.0, math.log(0.5), math.log(15.0), math.log(1 / 1200)]
        fitted = torch.tensor(start, dtype=torch.float32, requires_grad=True)
        optimiser = torch.optim.Adam([fitted], lr=0.03)
        for _ in range(steps):
            middle, slopes, by_opens = fitted[0], fitted[1:-4], fitted[-4]
            spread, steep, chance = fitted[-3:].exp()
            likely = torch.stack([self._likelihood(one, by_opens, steep, chance) for one in histories])
            before = torch.log_softmax(-0.5 * ((LIMITS - (middle + normal @ slopes)[:, None]) / spread) ** 2, dim=1)
            loss = 0.5 * ((slopes / SLOPE) ** 2).sum() + 0.5 * by_opens**2
            loss = loss - torch.logsumexp(likely + before, dim=1).sum()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        after = torch.softmax(likely + before, dim=1).detach()
        self.limits = (after * LIMITS).sum(dim=1)  # of the machines, by all their history
        self.middle, self.slopes, self.by_opens = float(middle.detach()), slopes.detach(), float(by_opens.detach())
        self.spread, self.steepness, self.chance = (float(one.detach()) for one in (spread, steep, chance))

    def normal(self, before: torch.Tensor) -> torch.Tensor:
        """Return what is known beforehand with mean 0 and variance 1."""
        return (before - self.mean) / self.std

    def expected(self, before: torch.Tensor) -> torch.Tensor:
        """Return the limits that are expected before a wire has broken."""
        return self.middle + self.normal(before) @ self.slopes

    @staticmethod
    def _likelihood(one: History, by_opens: torch.Tensor, steep: torch.Tensor, chance: torch.Tensor) -> torch.Tensor:
        counted = one.flux + by_opens * one.opens
        hazard = chance + torch.exp((steep * (counted[:, None] - LIMITS)).clamp(-30, 8)) / 60
        return torch.log(hazard[one.broke]).sum(dim=0) - (hazard * one.seconds[:, None]).sum(dim=0)

    def per_s(self, over: torch.Tensor) -> torch.Tensor:
        """Return the hazard of a flux over the limit (logarithms)."""
        return self.chance + torch.exp((self.steepness * over).clamp(-30, 5)) / 60


# 3. the student
EXPONENT = 0.75  # growth of the rate's logarithm with the flux's: 0.6 to 1.0 on the training machines
CAP, CAP_SPREAD = math.log(0.85), 0.3  # flux at the shortest period, where the supply gives no more: 0.5 to 1.4
SHORTS, SHORTS_SPREAD, SHORTS_FALL = math.log(0.06), 0.9, (1.0, 9.0)  # share a exp(-b target) of shorts: a, and b
WORN, WANDER = 0.15, 0.003  # drift of the limit in a shift, and its wandering per second (ours)
IN_SHORTS_PER_S = 1 / 3600  # wires that break in shorts, whatever the flux (ours)
LEAST_US, WORKPIECE_S = 12.5, 80.0


class Shop:
    """Shifts of one machine each, drawn from the model: second by second, with wires that break."""

    def __init__(self, hazard: Hazard, count: int) -> None:
        self.hazard, self.count = hazard, count
        alike = torch.randint(len(hazard.before), (count,))  # like a training machine in what is known beforehand
        before = hazard.before[alike] + 0.3 * hazard.std * torch.randn(count, len(hazard.mean))
        self.dials, self.fifths = before[:, : len(DIALS)], before[:, len(DIALS) :].clamp(min=0.02)
        self.limit = hazard.expected(before) + hazard.spread * torch.randn(count)
        self.height = torch.ones(count)  # of the workpiece at work, in the greatest
        self.cap = CAP + CAP_SPREAD * torch.randn(count)
        self.worn = -WORN * torch.rand(count) / SHIFT_S
        self.shorts = torch.exp(SHORTS + SHORTS_SPREAD * torch.randn(count)).clamp(max=0.3)
        self.fall = torch.empty(count).uniform_(*SHORTS_FALL)
        self.lost, self.age, self.spent, self.held, self.flux, self.broke = torch.zeros(6, count)
        self.shown = torch.zeros(count, 3)  # shorts, opens, period of the last second

    def observation(self) -> torch.Tensor:
        """Return the entries of `SHOWN`, (count, entries)."""
        age, spent = (self.age / 60).clamp(max=1), (self.spent / SHIFT_S).clamp(max=1)
        known = torch.stack([self.lost / WIRES, age, spent, self.held, self.flux, self.broke], dim=1)
        reached = (5 * self.height[:, None] - torch.arange(5)).clamp(0, 1)
        fifths = self.fifths * reached * (1 + 0.1 * torch.randn(self.count, 5))
        return torch.cat([self.dials, fifths / fifths.sum(dim=1, keepdim=True), known, self.shown], dim=1)

    def ignited(self, target: torch.Tensor) -> torch.Tensor:
        """Return the share of pulses that ignite: no shorts, and no opens, which are as many more as the target."""
        return 1 - target - 2 * self.shorts * torch.exp(-self.fall * target)

    def hot(self, flux: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """Return the hazard of a flux at a target, per s."""
        opens = self.shorts * torch.exp(-self.fall * target) + target
        return self.hazard.per_s(flux + self.hazard.by_opens * (opens - OPENS) - self.limit)

    def look_ahead(self) -> None:
        """Note what one who knows the machine would reach; it changes slowly."""
        targets = [torch.full((self.count,), target) for target in torch.linspace(0, MOST_TARGET, 9).tolist()]
        nets = [self.net(self.limit + step, targets[0]) for step in torch.linspace(-0.5, 0.2, 9)]
        self.best = torch.stack(nets).amax(dim=0)
        self.most_ignited = torch.stack([self.ignited(target) for target in targets]).amax(dim=0)

    def net(self, flux: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """Return the rate by holding a flux at a target, less what broken wires take."""
        # in the test cut a broken wire costs its time only as far as that lasts
        lost_s = torch.where(self.spent < TEST_S - THREADING_S, 0.3, 1.0) * (THREADING_S + RISE_S)
        flux = torch.minimum(flux, self.cap)
        return torch.exp(EXPONENT * flux) / (1 + self.hot(flux, target) * lost_s)

    def loss(self, hold: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """Return which share of the best net rate a hold and a target lose, (count,); the limit is known here."""
        # beyond the cap more hold earns nothing, and breaks the next wire
        by_hold = 1 - self.net(hold, target) / self.best + 0.02 * (hold - self.cap).clamp(min=0)
        by_target = 1 - self.ignited(target) / self.most_ignited
        # below the cap the law makes up by the period for what does not ignite, but in shorts it does not cut
        return by_hold + torch.where(hold.detach() > self.cap, 1.0, 0.4) * by_target

    def step(self, hold: torch.Tensor, target: torch.Tensor) -> None:
        """Hold fluxes and targets for a second."""
        rising = torch.where(self.age < 1.5, 0.6, 1.0).log()
        flux = torch.minimum(hold + rising, self.cap) + 0.04 * torch.randn(self.count)
        shorted = torch.rand(self.count) < IN_SHORTS_PER_S
        broken = shorted | (torch.rand(self.count) < 1 - torch.exp(-self.hot(flux, target)))
        noise = torch.where(shorted, -2.5 * torch.rand(self.count), 0.03 * torch.randn(self.count))
        self.broke = torch.where(broken, flux + noise, self.broke)
        self.lost += broken
        self.age = torch.where(broken, 0.0, self.age + 1)
        self.spent += torch.where(broken, THREADING_S + 0.5, 1.0)
        self.held, self.flux = hold, flux
        self.limit = self.limit + self.worn + WANDER * torch.randn(self.count)
        fresh = torch.rand(self.count) < 1 / WORKPIECE_S
        self.height = torch.where(fresh, 0.5 + 0.5 * torch.rand(self.count), self.height)
        short = self.shorts * torch.exp(-self.fall * target + 0.3 * torch.randn(self.count))
        short = torch.where(shorted, 0.3 + 0.6 * torch.rand(self.count), short)
        period = torch.log10(LEAST_US * torch.exp((self.cap - flux).clamp(min=0)))
        opens = (short + target + 0.03 * torch.randn(self.count)).clamp(min=0)
        self.shown = torch.stack([short, opens, period / 4], dim=1)


class Student(torch.nn.Module):
    """An LSTM that remembers a shift; it says what to hold, as the logarithm of the flux, and the servo's target."""

    def __init__(self, hazard: Hazard, cells: int) -> None:
        super().__init__()
        means = [0.02, 0.5, 0.5, -0.5, -0.5, -0.3, 0.06, 0.15, 0.32]
        stds = [0.02, 0.4, 0.3, 0.5, 0.5, 0.5, 0.06, 0.1, 0.05]
        self.mean = torch.tensor([*hazard.mean, *means]).float()
        self.std = torch.tensor([*hazard.std[: len(DIALS)], *[0.05] * 5, *stds]).float()
        self.memory, self.out = torch.nn.LSTMCell(len(SHOWN), cells), torch.nn.Linear(cells, 2)
        with torch.no_grad():
            self.out.weight.mul_(0.1)
            self.out.bias.copy_(torch.tensor([-0.5, action_of(hazard.middle - 0.5)]))

    def forward(self, shown: torch.Tensor, memory):
        """Return the logarithm of the hold (n,), the target (n,), and the memory."""
        memory = self.memory(((shown - self.mean) / self.std).clamp(-10, 10), memory)
        target, hold = self.out(memory[0]).clamp(-1, 1).T
        hold = math.log(HOLD.low) + 0.5 * (hold + 1) * math.log(HOLD.high / HOLD.low)
        return hold, 0.5 * (target + 1) * MOST_TARGET, memory


def taught(hazard: Hazard, shifts: int, machines: int = 128, cells: int = 32, seconds: int = 100) -> Student:
    """Return a student who has learned from a number of shifts, each on many machines at once."""
    student = Student(hazard, cells)
    optimiser = torch.optim.Adam(student.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, shifts, 1e-4)
    for shift in range(1, shifts + 1):
        shop, memory, dither, total = Shop(hazard, machines), None, torch.zeros(machines), 0.0
        for _ in range(SHIFT_S // seconds):
            losses = []
            shop.look_ahead()
            for _ in range(seconds):
                hold, target, memory = student(shop.observation(), memory)
                losses.append((shop.loss(hold, target) * (shop.spent < SHIFT_S)).mean())
                dither = 0.9 * dither + 0.015 * torch.randn(machines)
                shop.step((hold + dither).detach(), target.detach())
            loss = torch.stack(losses).mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(student.parameters(), 1.0)
            optimiser.step()
            memory = tuple(part.detach() for part in memory)
            total += float(loss.detach()) * seconds / SHIFT_S
        schedule.step()
        if shift % 10 == 0:
            wires = float(shop.lost.mean())
            print(f"{shift} shifts: {total:.1%} less than who knows the limit, {wires:.1f} wires", flush=True)
    return student


def save(student: Student, file: Path, command: str, steps: int, seed: int) -> None:
    """Write the student as a policy of edmsim; entries that it does not look at are divided by a great number."""
    mean, variance = np.zeros(len(NAMES)), np.full(len(NAMES), 1e12)
    columns = [AT[name] for name in SHOWN]
    mean[columns], variance[columns] = student.mean.numpy(), student.std.numpy() ** 2
    cell = {name: value.detach().double().numpy() for name, value in student.memory.named_parameters()}
    inputs = np.zeros((len(NAMES), cell["weight_ih"].shape[0]))
    inputs[columns] = cell["weight_ih"].T
    lstm = inputs, cell["weight_hh"].T, cell["bias_ih"] + cell["bias_hh"]
    out = student.out.weight.detach().double().numpy(), student.out.bias.detach().double().numpy()
    write_policy(
        file, env_id=ENV_ID, environment=ENVIRONMENT, hold=HOLD, mean=mean, variance=variance, lstm=lstm,
        weights=[out[0].T], biases=[out[1]], algorithm="adapt", command=command, seed=seed, steps=steps,
    )


def main() -> None:
    """Record what is missing, fit, teach, save."""
    parser = argparse.ArgumentParser(description="A student that adapts to machines of edmsim/MaxRateShift-v0.")
    parser.add_argument("--machines", type=int, default=100, help="training machines")
    parser.add_argument("--shifts", type=int, default=150, help="simulated shifts that the student learns from")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder for histories and the policy")
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    files = [arguments.out / f"{FIRST_SEED + k}.npz" for k in range(arguments.machines)]
    for k, file in enumerate(files):
        if not file.exists():
            record(FIRST_SEED + k, SECONDS, file)
            print(f"{k + 1} of {len(files)} machines recorded", flush=True)
    histories = [history_of(file) for file in files]
    hazard = Hazard(histories)
    wires = sum(int(one.broke.sum()) for one in histories)
    print(f"{wires} wires broke by their heat on {len(histories)} machines, whose limits' "
          f"logarithms have a deviation of {float(hazard.limits.std()):.2f}, {hazard.spread:.2f} with what is "
          f"known beforehand; steepness {hazard.steepness:.1f}", flush=True)
    student = taught(hazard, arguments.shifts)
    steps = sum(len(one.flux) for one in histories)
    options = f"--machines {arguments.machines} --shifts {arguments.shifts} --seed {arguments.seed}"
    command = f"python examples/learning/adapt.py {options}"
    save(student, arguments.out / "policy.json", command, steps, arguments.seed)


if __name__ == "__main__":
    main()
