"""Parts: episodes of `edmsim.envs.part_task.Part` side by side; actions, observations, rewards and infos."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.passes import Sums
from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.part_cut import Choice, PartCut, Step
from edmsim.envs.part_task import ACTIONS, ENTRIES, LEFT_UM, TERMS, Part
from edmsim.envs.task import EnvArguments
from edmsim.errors import InputError
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.machine.setting import open_V

MOST_DRAWS = 20
"""Machines drawn before giving up on one that takes the technology's settings (ours)."""


NO_STEP = Step(Sums(), 0.0, 0.0, 0.0, False)
"""What has been done before the first step."""


@dataclass
class PartEpisode:
    """An episode, and what its last step did."""

    family: Part  # its arguments
    cut: PartCut
    random: np.random.Generator  # of what is drawn during the episode: the gauge's errors
    tension_share: float
    step: Step = NO_STEP
    action: Floats = field(default_factory=lambda: np.zeros(len(ACTIONS)))
    number: int = 0  # of the pass that was cut
    # what the gauge says of the metal left, less what is wanted; NaN where nothing was measured
    left_um: float = math.nan
    terms: Floats = field(default_factory=lambda: np.zeros(len(TERMS)))  # of the reward
    # the last two of the whole part, NaN before its end
    cost: float = 0.0
    error_um: float = math.nan
    ra_um: float = math.nan

    @property
    def ended(self) -> bool:
        """Whether the episode has terminated."""
        return self.cut.cause is not StopCause.RUNNING and not self.goes_on

    @property
    def goes_on(self) -> bool:
        """Whether a wire broke and another is there."""
        return self.cut.broken and self.cut.wires_lost < self.family.wires

    @property
    def late(self) -> bool:
        """Whether its time is over, to the nanosecond, as `PartCut.run` counts it."""
        return round(self.cut.cutting_s * 1e9) >= round(self.family.episode_s * 1e9)


class Parts:
    """Parts of one environment side by side, `threads` at the same time; what `Batch` is to sub-environments."""

    def __init__(self, family: Part, count: int, threads: int = 1) -> None:
        self.family = family
        self.episodes: list[PartEpisode | None] = [None] * count
        self._threads = min(threads, count)
        self._pool: ThreadPoolExecutor | None = None

    def change(self, family: EnvArguments) -> None:
        """Let episodes begun from now on have other arguments."""
        assert isinstance(family, Part)
        self.family = family

    # --- beginning ---

    def begin(
        self, index: int, rng: np.random.Generator, machine: Machine | None, *, redraw: bool
    ) -> dict[str, Any]:
        """Begin an episode; of one pass only, the passes before it are cut now. Returns the info of the reset."""
        if machine is not None:
            raise InputError(
                "Part cuts with the machine of its technology: make it with height_mm and tension_share of one value "
                "and randomise=None for one machine"
            )
        family = self.family
        for _ in range(MOST_DRAWS):
            drawn: dict[str, float | str] = {}
            cut = self._drawn(rng, drawn)
            gauge = np.random.default_rng(int(rng.integers(2**62)))
            one = PartEpisode(family, cut, gauge, float(drawn["tension_share"]))
            if self._prepared(one):
                break
        else:
            raise InputError(f"none of {MOST_DRAWS} machines came to pass {family.only_pass}: draw fewer constants")
        self.episodes[index] = one
        return {"drawn": drawn, "plant_seed": cut.seed, "total_um": cut.total_um}

    def _drawn(self, rng: np.random.Generator, drawn: dict[str, float | str]) -> PartCut:
        """Draw a machine that takes the settings of the technology."""
        refused: InputError | None = None
        for _ in range(MOST_DRAWS):
            drawn.clear()
            settings = self.family.draw(rng, drawn)
            try:
                return PartCut(self.family.read, settings, float(drawn["tension_share"]), self.family.only_pass)
            except InputError as error:
                refused = error
        assert refused is not None
        raise refused

    def _prepared(self, one: PartEpisode) -> bool:
        """Cut the passes before the one that is the episode, as the technology has them; say if they were cut."""
        cut, only = one.cut, one.family.only_pass
        while only is not None and cut.number < only:
            self._cut(one, np.zeros(len(ACTIONS)))
            if one.ended or one.late:
                return False
        cut.begin_count()
        return True

    # --- a step ---

    def clear(self) -> None:
        """Forget what the last step earned and cost."""
        for one in self.episodes:
            if one is not None:
                one.terms, one.cost = np.zeros(len(TERMS)), 0.0

    def step(self, active: NDArray[np.int64], actions: NDArray[np.float32]) -> Floats:
        """Cut a pass in the active sub-environments, or the rest of one."""
        self.clear()
        jobs = [(self.episode(int(k)), np.clip(actions[k].astype(np.float64), -1.0, 1.0)) for k in active]
        if self._threads > 1 and len(jobs) > 1:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(self._threads)
            for done in [self._pool.submit(self._step_one, *job) for job in jobs]:
                done.result()
        else:
            for job in jobs:
                self._step_one(*job)
        terms = np.array([np.zeros(len(TERMS)) if one is None else one.terms for one in self.episodes])
        chosen = [TERMS.index(name) for name in self.family.objectives]
        return np.asarray(terms[:, chosen] if chosen else terms.sum(axis=1))

    def episode(self, index: int) -> PartEpisode:
        """Return the present episode of a sub-environment."""
        one = self.episodes[index]
        assert one is not None
        return one

    def _step_one(self, one: PartEpisode, action: Floats) -> None:
        self._cut(one, action)
        self._pay(one)

    def _cut(self, one: PartEpisode, action: Floats) -> None:
        """Cut a pass, and gauge its wall."""
        family, cut = one.family, one.cut
        one.number, one.action, one.left_um = cut.number, action, math.nan
        octaves = action[:3] * (family.set_point_octaves, family.pause_octaves, family.on_time_octaves)
        set_point, pause, on_time = (2.0 ** float(octave) for octave in octaves)
        choice = Choice(set_point, pause, on_time, float(action[3]) * family.offset_um)
        one.step = cut.run(choice, family.episode_s)
        wall = None if one.step.broke else cut.wall(one.number)
        if wall is not None:
            error_um = family.gauge_um * float(one.random.standard_normal())
            one.left_um = wall.mean_um - cut.target_um(one.number) + error_um

    def _pay(self, one: PartEpisode) -> None:
        """Work out what a step earned and cost."""
        cut, weights = one.cut, one.family.reward_weights
        one.terms[TERMS.index("time")] = -weights.time * one.step.seconds / 60.0
        if one.step.broke:
            threading_s = one.family.base.base.table.threading_s.value
            one.terms[TERMS.index("wire_break")] = -weights.wire_break * threading_s / 60.0
            one.cost = 1.0
        if cut.cause is StopCause.FINISHED:
            one.error_um, one.ra_um = cut.error_um(), cut.ra_um()
            for name, value in (("error", one.error_um), ("roughness", one.ra_um)):
                one.terms[TERMS.index(name)] = -getattr(weights, name) * (value if math.isfinite(value) else 0.0)
        elif one.ended:
            one.terms[TERMS.index("limit")] = -weights.limit
            one.cost = 1.0

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Which episodes (n,) have terminated."""
        return np.array([one is not None and one.ended for one in self.episodes])

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which sub-environments (n,) have cut for as long as an episode lasts."""
        return np.array([one is not None and one.late for one in self.episodes])

    # --- what is shown ---

    def observations(self) -> NDArray[np.float32]:
        """Return every sub-environment's observation, in a fresh array; 0 where no episode has begun."""
        rows = [np.zeros(len(ENTRIES)) if one is None else self._observation(one) for one in self.episodes]
        low, high = (np.array([getattr(entry, end) for entry in ENTRIES]) for end in ("low", "high"))
        return np.asarray(np.clip(np.array(rows), low, high), np.float32)

    def _observation(self, one: PartEpisode) -> list[float]:
        cut, step, family = one.cut, one.step, one.family
        sums, measured = step.sums, [0.0] * 8
        if step.seconds > 0.0 and sums.pulses:
            left = one.left_um
            usual_um_s = cut.table.settings[one.number - 1].feed_mm_min / 0.06
            measured = [
                sums.short / sums.pulses, sums.open / sums.pulses, (sums.spark + sums.arc) / sums.pulses,
                abs(sums.voltage_s) / step.seconds / open_V(family.base),
                math.log2(max(step.travel_um / step.seconds / usual_um_s, 1e-3)),
                left / LEFT_UM if math.isfinite(left) else 0.0, float(math.isfinite(left)), float(step.broke),
            ]  # fmt: skip
        return [
            *measured, *one.action.tolist(), cut.number / cut.passes, cut.rest_share, cut.wires_lost / family.wires,
            cut.cutting_s / family.episode_s, cut.height_mm / 50.0, one.tension_share,
        ]  # fmt: skip

    def infos(self) -> dict[str, Any]:
        """Return what `info` tells at every step, in fresh arrays (n,); -1 where an error or Ra is not known.

        Texts say why the episode ended and what the generator refused, and are empty where nothing did.
        """
        episodes = [self.episode(k) for k in range(len(self.episodes))]
        rows, terms = [self._info(one) for one in episodes], np.array([one.terms for one in episodes])
        return {
            **{name: np.array([row[name] for row in rows]) for name in rows[0]},
            "reward_terms": {name: terms[:, k].copy() for k, name in enumerate(TERMS)},
            "cause": np.array([WORDS[one.cut.cause].info if one.ended else "" for one in episodes], object),
            "refused": np.array([one.cut.refused for one in episodes], object),
        }

    def _info(self, one: PartEpisode) -> dict[str, Any]:
        cut, sums = one.cut, one.step.sums
        known = {"error_um": one.error_um, "ra_um": one.ra_um}
        wall = None if one.step.broke else cut.wall(one.number)
        return {
            "time_s": cut.time_s, "dt_s": one.step.seconds, "path_um": cut.path_um, "pass": one.number,
            "offset_um": cut.offset_um, "t_on_us": cut.setting.t_on_us, "t_period_us": cut.setting.t_period_us,
            "feed_um_s": one.step.travel_um / one.step.seconds if one.step.seconds else 0.0,
            "short": sums.short, "open": sums.open, "spark": sums.spark, "arc": sums.arc,
            "left_um": 0.0 if wall is None else wall.mean_um, "wanted_um": cut.target_um(max(one.number, 1)),
            "area_mm2": one.step.face_mm2, "wires_lost": cut.wires_lost, "cost": one.cost,
            **{name: value if math.isfinite(value) else -1.0 for name, value in known.items()},
        }  # fmt: skip

    def close(self) -> None:
        """Shut down the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs: it starts threads of its own."""
        return {**self.__dict__, "_pool": None}
