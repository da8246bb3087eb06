"""Batch: actions, observations, rewards and infos of parallel episodes, all sub-environments at once."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.compiled.random import key_of
from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs import servo
from edmsim.envs.knobs import least_setting_us
from edmsim.envs.observation_builder import ObservationBuilder
from edmsim.envs.path_follower import RUNNING
from edmsim.envs.reward import StepRewards
from edmsim.envs.sub_envs import SubEnvs
from edmsim.envs.task import EnvArguments, Family
from edmsim.machine.machine import Machine

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_CAUSES = np.array(["" if cause is StopCause.RUNNING else WORDS[cause].info for cause in StopCause], object)
"""Texts of `info` for what ended an episode, by the numbers of causes."""


def action_space_of(family: EnvArguments) -> gym.spaces.Box[np.float32]:
    """Return the action space, with one entry for each of `EnvArguments.action_names`."""
    return gym.spaces.Box(-1.0, 1.0, (len(family.action_names),), np.float32)


def observation_space_of(family: EnvArguments) -> gym.spaces.Box[np.float32]:
    """Return the observation space."""
    entries = family.entries()
    low, high = (np.array([getattr(e, end) for e in entries], np.float32) for end in ("low", "high"))
    return gym.spaces.Box(low, high, dtype=np.float32)


def reward_space_of(family: EnvArguments) -> gym.spaces.Box[np.float32]:
    """Return the space of rewards: as many as objectives, or one."""
    return gym.spaces.Box(-np.inf, np.inf, (len(family.objectives) or 1,), np.float32)


STEP_INFO = np.dtype(
    [
        ("time_s", "f8"),  # machine time at the end of the step
        ("dt_s", "f8"),  # that of the step
        ("path_um", "f8"),  # length of path behind the wire by the planner, over all legs
        ("feed_um_s", "f8"),
        ("offset_um", "f8"),
        ("t_on_us", "f8"),
        ("t_period_us", "f8"),
        ("energy_mJ", "f8"),  # of a discharge of the setting
        ("short", "i8"),  # pulses of the step by class
        ("open", "i8"),
        ("spark", "i8"),
        ("arc", "i8"),
        ("gap_um", "f8"),  # mean of the last window's ignitions; -1 without any, as checkers take no NaN for another
        ("wire_temperature_K", "f8"),  # greatest of the last window
        ("debris", "f8"),  # at its end
        ("error_um", "f8"),  # distance of the wire from the path at its end
        ("area_mm2", "f8"),  # cut in the step
        ("wires_lost", "i8"),  # in the episode
        ("cost", "f8"),  # of the step
    ]
)
"""Numbers of `info` at every step; a real machine does not measure all of them."""


@exactly_compiled
def fill_infos(
    rows: NDArray[np.void], states: NDArray[np.void], windows: NDArray[np.void], shown: NDArray[np.void],
    accounts: NDArray[np.void], infos: NDArray[np.void],
) -> None:
    """Write `STEP_INFO` (n,) of all sub-environments, from the records of their plants, observations and rewards."""
    for i in range(infos.shape[0]):
        info, row, window, sums, account = infos[i], rows[i], windows[i], shown[i], accounts[i]
        setting_us, ignitions = row.setting_us, window.ignitions
        info.time_s = states[i].time_ns * 1e-9
        info.dt_s = row.step_ns * 1e-9
        info.path_um = row.before_um + row.path_um
        info.feed_um_s = row.feed_um_s
        info.offset_um = row.offset_um
        info.t_on_us = setting_us[0]
        info.t_period_us = setting_us[1]
        info.energy_mJ = row.energy_mJ
        info.short = sums.short
        info.open = sums.open
        info.spark = sums.ignited - sums.arc
        info.arc = sums.arc
        info.gap_um = window.gap_um / ignitions if ignitions > 0 else -1.0
        info.wire_temperature_K = window.temperature_max_K
        info.debris = window.debris
        info.error_um = row.error_um
        info.area_mm2 = account.area_mm2
        info.wires_lost = row.wires_lost
        info.cost = account.cost


class Batch:
    """Parallel episodes of one family, with what Gymnasium's environments show of them."""

    def __init__(self, family: Family, count: int, threads: int = 1) -> None:
        self.family = family
        self.sub_envs = SubEnvs(family, count, threads)
        self.builder = ObservationBuilder(family, count, family.measured_by)
        self._servos: NDArray[np.void] = np.zeros(count, servo.SERVO)
        self._feed_um_s = np.zeros(count)
        self._episodes = np.zeros(count, np.int64)
        self._constants: list[dict[str, float | str]] = [{} for _ in range(count)]
        self.account = StepRewards(count)  # rewards, their terms and costs of the last step

    def change(self, family: EnvArguments) -> None:
        """Let episodes begun from now on be of another family, with the same spaces and plants of the same kind."""
        assert isinstance(family, Family)
        self.family = self.sub_envs.family = self.builder.family = family
        self._episodes[:] = 0

    def begin(self, index: int, rng: np.random.Generator, machine: Machine | None, *, redraw: bool) -> dict[str, Any]:
        """Begin an episode, on `machine` if given, with `redraw` never on the last one; returns the reset's info."""
        family, before = self.family, self.sub_envs.scenarios[index]
        chosen = machine
        lasts = 0 < self._episodes[index] < family.machine_episodes
        if chosen is None and before is not None and lasts and not redraw:
            chosen = before.machine
        scenario = family.draw(rng, chosen)
        if chosen is None:
            self._constants[index] = {name: scenario.drawn[name] for name in family.drawn_constants}
        self._episodes[index] = 0 if machine is not None else (self._episodes[index] if chosen is not None else 0) + 1
        self.sub_envs.begin(index, scenario)
        self.account.weigh(index, family.reward_weights, family.error_bound_um, family.energy_bound_mJ)
        self.builder.begin(index, self.sub_envs.rows[index], scenario.machine, key_of(scenario.plant_seed + 1))
        self._begin_wire(index)
        constants = self._constants[index] if machine is None else {}
        return {
            "drawn": {**constants, **scenario.drawn}, "plant_seed": scenario.plant_seed,
            "total_um": float(self.sub_envs.rows[index]["total_um"]),
        }

    def _begin_wire(self, index: int) -> None:
        feed_um_s = self.sub_envs.families[index].first_feed_um_s
        self._feed_um_s[index] = feed_um_s
        servo.begin(self._servos[index], feed_um_s)

    def clear(self) -> None:
        """Forget what the last step earned and cost."""
        self.account.begin()

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Which episodes (n,) have terminated."""
        return np.asarray(self.sub_envs.rows["cause"] != RUNNING)

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which sub-environments (n,) have cut for as long as an episode lasts."""
        return self.sub_envs.out_of_time

    def close(self) -> None:
        """Shut down the threads."""
        self.sub_envs.fleet.close()

    def step(self, active: Ints, actions: NDArray[np.float32]) -> Floats:
        """Run a step in the active environments; returns the rewards (n,), or (n, objectives), 0 in the others."""
        sub_envs = self.sub_envs
        clamped = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)  # np.clip takes four times as long
        self.account.begin()
        self.builder.begin_step()
        sub_envs.rows["step_ns"] = 0
        for family, left in self._by_family(active):
            self._command(family, left, clamped)
            while len(left):
                self._window(family, left)
                left = self._waiting(family, left)
        self.builder.end_step(active)
        account, objectives = self.account, self.family.objectives
        return np.stack([account.terms[name] for name in objectives], axis=1) if objectives else account.total.copy()

    def _by_family(self, active: Ints) -> Iterator[tuple[Family, Ints]]:
        """Yield the families whose episodes run, each with its sub-environments; after a `change` there are more."""
        families = [self.sub_envs.families[k] for k in active]
        present = {id(one): one for one in families}
        for family in present.values():
            yield family, active if len(present) == 1 else active[[one is family for one in families]]

    def _command(self, family: Family, active: Ints, clamped: Floats) -> None:
        """Turn the knobs, and set the offsets, and the feed or the servos' targets."""
        sub_envs = self.sub_envs
        if family.knobs:
            for k in active:
                first_us = sub_envs.rows[k]["first_setting_us"]
                self._set_generator(int(k), *family.setting_us(first_us, clamped[k, 1 : 1 + len(family.knobs)]))
        if family.offset_um is not None:
            sub_envs.rows["offset_um"][active] = clamped[active, -1] * family.offset_um
        if family.action == "servo":
            self._servos["target"][active] = servo.target_of(clamped[active, 0], family.servo_target_share)
            return
        limit = family.greatest_feed_um_s
        requested_um_s = family.next_feed_um_s(self._feed_um_s[active], clamped[active, 0])
        self._feed_um_s[active] = np.minimum(np.maximum(requested_um_s, -limit), limit)

    def _window(self, family: Family, left: Ints) -> None:
        """Run a window in some sub-environments."""
        sub_envs, by_servo = self.sub_envs, family.action == "servo"
        sub_envs.advance(left, self._servos["feed_um_s"].copy() if by_servo else self._feed_um_s)
        windows = sub_envs.fleet.windows
        self.builder.add(left, sub_envs.rows, windows)
        self.account.add(left, sub_envs.rows, sub_envs.near, windows)
        if by_servo:
            servo.respond(left, self._servos, windows, family.greatest_feed_um_s, *family.servo_gains)
        for index, setting_us in sub_envs.lost:
            self.builder.lose_wire(index, sub_envs.rows[index], setting_us)
            self._begin_wire(index)

    def _waiting(self, family: Family, left: Ints) -> Ints:
        """Return those of some sub-environments whose next action is not due yet."""
        if family.decision_s is None:
            return left[:0]
        wait_ns, rows = round(family.decision_s * 1e9), self.sub_envs.rows
        return np.asarray(left[(rows["step_ns"][left] < wait_ns) & (rows["cause"][left] == RUNNING)])

    def _set_generator(self, index: int, t_on_us: float, t_period_us: float) -> None:
        """Set the generator; in place of a period that it refuses, the shortest that it accepts for the on-time."""
        sub_envs = self.sub_envs
        sub_envs.set_generator(index, t_on_us, t_period_us)
        refused = sub_envs.refused[index]
        if refused:
            machine = sub_envs.fleet.plants[index].machine
            sub_envs.set_generator(index, *least_setting_us(machine, t_on_us, sub_envs.families[index].detents_us))
            sub_envs.refused[index] = refused
        self.builder.take_scale(index, sub_envs.rows[index])

    def observations(self) -> NDArray[np.float32]:
        """Return every sub-environment's observation, in a fresh array."""
        sub_envs = self.sub_envs
        return self.builder.observations(sub_envs.rows, sub_envs.corner_um, sub_envs.corner_deg)

    def infos(self) -> dict[str, Any]:
        """Return what `info` tells at every step, in fresh arrays (n,); much of it no real machine knows.

        Numbers are those of `STEP_INFO`. Texts say why the episode ended and what the generator refused, and are
        empty where nothing did.
        """
        sub_envs, fleet = self.sub_envs, self.sub_envs.fleet
        step: NDArray[np.void] = np.empty(sub_envs.count, STEP_INFO)
        fill_infos(sub_envs.rows, fleet.states, fleet.windows, self.builder.sums, self.account.rows, step)
        return {
            **{name: step[name] for name in STEP_INFO.names or ()},
            "reward_terms": self.account.terms,
            "cause": _CAUSES[sub_envs.rows["cause"]],
            "refused": sub_envs.refused.copy(),
        }
