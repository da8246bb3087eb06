"""Part: machine, draws and reward of a part; actions and observations of every pass; and parts side by side."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.passes import Sums
from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.arguments import Range, argument, check_kinds, ends_of, record_of_arguments
from edmsim.envs.observation import Entry
from edmsim.envs.part_cut import Choice, PartCut, Step
from edmsim.envs.reward import WeightsOfTerms
from edmsim.envs.task import Drawn, EnvArguments, names_of
from edmsim.errors import InputError
from edmsim.geometry import Floats
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import values_of
from edmsim.machine.setting import MOST_TIME_S, check_height, open_V
from edmsim.machine.technology import Technology, machine_of, read_technology
from edmsim.numeric import above_zero, whole_within, within
from edmsim.plant.resolution import resolution
from edmsim.program.outline import Program
from edmsim.program.path import load_program

ACTIONS = {
    "set_point": ("share of open pulses of the rough pass, or feed of a trim, log2", "``set_point_octaves``"),
    "pause": ("pause between two pulses, log2", "``pause_octaves``"),
    "on_time": ("on-time, log2", "``on_time_octaves``"),
    "offset": ("offset from the drawing, um; above 0 farther from the part", "``offset_um``"),
}
"""Entries of an action with their meaning and the unit of 1; 0 is what the technology has."""
LEFT_UM = 20.0
"""Metal left beyond what is wanted that its entry shows as 1 (ours: five times the error of a part)."""
ENTRIES = (
    Entry("short", 0.0, 1.0, "short pulses", "pulses of the step"),
    Entry("open", 0.0, 1.0, "open pulses", "pulses of the step"),
    Entry("spark", 0.0, 1.0, "pulses that ignited", "pulses of the step"),
    Entry("mean_voltage", 0.0, 1.0, "mean gap voltage, V", "nominal open voltage, V"),
    Entry("feed", -4.0, 4.0, "log2 of the mean feed over the technology's", "1"),
    Entry("left", -4.0, 4.0, "metal left by the pass, less what it is to leave, um", f"{LEFT_UM:g} um"),
    Entry("gauged", 0.0, 1.0, "1 if that was measured, else 0", "1"),
    Entry("broke", 0.0, 1.0, "1 if the step ended by a broken wire, else 0", "1"),
    *(Entry(f"last_{name}", -1.0, 1.0, f"entry {k} of the last action", "1") for k, name in enumerate(ACTIONS)),
    Entry("pass", 0.0, 1.0, "number of the pass that is decided on", "``passes``"),
    Entry("rest", 0.0, 1.0, "share of it that is to be cut", "1"),
    Entry("wires_lost", 0.0, 1.0, "wires that broke in the episode", "``wires``"),
    Entry("spent", 0.0, 1.0, "time of cutting, s", "``episode_s``"),
    Entry("height", 0.0, 8.0, "height of the workpiece, mm", "50 mm"),
    Entry("tension", 0.0, 4.0, "tension of the wire", "the technology's"),
)
"""Entries of an observation; the first eight, and the last action, are of the last step, 0 before there is one."""
MOST_OFFSET_UM = 50.0
"""Greatest change of an offset (ours: what a trim takes)."""
MOST_OCTAVES = 2.0
"""Greatest reach of a factor (ours: beyond it the generator refuses most settings)."""


@dataclass(frozen=True, kw_only=True)
class PartWeights(WeightsOfTerms):
    """Weights of the terms of Part's reward, 0 or more; all are costs. The values are ours."""

    time: float = 1.0  # cost of a minute of cutting
    error: float = 1.0  # cost per um of the finished part's error, root mean square over its contour and height
    roughness: float = 5.0  # cost per um of Ra of its face
    wire_break: float = 1.0  # cost of a minute of threading
    limit: float = 50.0  # cost of an unfinished part: its last wire broke, or a limit ended it


TERMS = tuple(f.name for f in fields(PartWeights))  # names of the reward's terms, in order: those of their weights


@record_of_arguments
class Part(EnvArguments):
    """Machine, draws and reward of a part; the fields are the environment's arguments.

    {parameters}

    Raises
    ------
    InputError
        If a value cannot be used.

    Notes
    -----
    `only_pass`: a reset cuts the earlier passes with the technology's values, which takes as long as cutting them in
    steps. The episode is that pass; the error is that of its wall.

    `randomise`: sections or constants of `Machine.sample`; ``()`` draws all constants that have a published range
    and an effect and are no dial of the operator (see `draws`).
    """

    resolution: str = argument("fast", "", "resolution of the plant: fast, default, fine")
    program: str | Path | None = argument(None, "", "G-code or DXF of a contour; None: a punch of 1.6 x 0.4 mm")
    technology: str | Path = argument("tool-steel-brass-254", "", "a name under models/technologies, or a file")
    passes: int = argument(4, "", "number of passes, rough and trims, 2 or more")
    only_pass: int | None = argument(None, "", "pass that is the episode; None: all passes")
    tab_mm: float = argument(0.6, "mm", "length of the edge that holds the part; 0: none")
    # ours: about the height of the shop's table, within what the technology is interpolated for
    height_mm: Range = argument((18.0, 36.0), "mm", "height, or (low, high)")
    tension_share: Range = argument((0.85, 1.05), "", "tension over the technology's, or (low, high)")  # ours
    randomise: Sequence[str] | None = argument((), "", "constants to draw; ``()`` for all, None for none")
    set_point_octaves: float = argument(1.0, "octaves", "reach of the set-points either way")
    pause_octaves: float = argument(2.0, "octaves", "reach of the pauses")
    on_time_octaves: float = argument(0.5, "octaves", "reach of the on-times")
    offset_um: float = argument(20.0, "um", "reach of the offsets")
    gauge_um: float = argument(1.0, "um", "standard error of the measurement of a wall")  # ours: a touch probe's
    wires: int = argument(4, "", "wires before a break ends the episode")
    episode_s: float = argument(1800.0, "s", "time of cutting after which an episode is truncated")
    weights: PartWeights | None = argument(None, "", "`PartWeights`, or a mapping of weights to change")
    objectives: Sequence[str] = argument((), "", "terms of a vector reward; ``()``: a scalar")
    cost_limit: float = argument(0.1, "", "limit of an episode's mean cost")  # ours: a break in ten parts

    own_weights: ClassVar[PartWeights] = PartWeights()
    lasting: ClassVar[tuple[str, ...]] = ("objectives",)

    def __post_init__(self) -> None:
        """Refuse what cannot be used, before anything is built."""
        check_kinds(self)
        resolution(self.resolution)
        whole_within("passes", self.passes, 2, 100)
        whole_within("wires", self.wires, 1, 10**9)
        if self.only_pass is not None:
            whole_within("only_pass", self.only_pass, 1, self.passes)
        for height in ends_of("height_mm", self.height_mm):
            check_height(height)
            self.cut_with.table(height, self.passes)
        within("tab_mm", self.tab_mm, 0.0, 100.0)
        for name in ("set_point_octaves", "pause_octaves", "on_time_octaves"):
            above_zero(name, getattr(self, name), MOST_OCTAVES)
        above_zero("offset_um", self.offset_um, MOST_OFFSET_UM)
        within("gauge_um", self.gauge_um, 0.0, MOST_OFFSET_UM)
        above_zero("episode_s", self.episode_s, MOST_TIME_S)
        self._check_reward(TERMS)
        self.drawn_constants  # noqa: B018 - refuses unknown names
        # what is drawn at most is refused here, and not at a reset
        heights, shares = (ends_of(name, getattr(self, name)) for name in ("height_mm", "tension_share"))
        PartCut(self.read, self._settings(heights[1], seed=0), shares[1], self.only_pass)

    @cached_property
    def cut_with(self) -> Technology:
        """The technology."""
        return read_technology(self.technology)

    @cached_property
    def read(self) -> Program:
        """The program."""
        return load_program(Path(__file__).with_name("small_part.ngc") if self.program is None else self.program)

    @cached_property
    def base(self) -> Machine:
        """The machine with the setting of its rough pass, before anything is drawn."""
        own = self.cut_with
        height_mm = ends_of("height_mm", self.height_mm)[0]
        return machine_of(own.table(height_mm, 1).settings[0], own.machine, own.material, own.wire, height_mm)

    @cached_property
    def drawn_constants(self) -> tuple[str, ...]:
        """Names of the constants that an episode draws."""
        return names_of(self.base, self.randomise, "modal")

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        return tuple(ACTIONS)

    def entries(self) -> list[Entry]:
        """Return every entry of an observation, in order."""
        return list(ENTRIES)

    def draw(self, rng: np.random.Generator, drawn: Drawn) -> CutSettings:
        """Draw a machine and the plant's seed; returns the settings of its cut.

        Parameters
        ----------
        rng : numpy.random.Generator
            Same state, same settings.
        drawn : dict
            The drawn values are added by name.
        """
        for name in ("height_mm", "tension_share"):
            drawn[name] = float(rng.uniform(*ends_of(name, getattr(self, name))))
        height_mm = float(drawn["height_mm"])
        names, constants = self.drawn_constants, tuple[tuple[str, float], ...]()
        if names:
            values = values_of(self.base.sample(rng, names), names)
            drawn |= values
            constants = tuple(values.items())
        return self._settings(height_mm, int(rng.integers(2**62)), constants)

    def _settings(self, height_mm: float, seed: int, constants: tuple[tuple[str, float], ...] = ()) -> CutSettings:
        return CutSettings(
            passes=self.passes, technology=str(self.technology), material=self.cut_with.material, tab_mm=self.tab_mm,
            height_mm=height_mm, constants=constants, resolution=self.resolution, seed=seed,
        )  # fmt: skip


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

    def begin(self, index: int, rng: np.random.Generator, machine: Machine | None, *, redraw: bool) -> dict[str, Any]:
        """Begin an episode; of one pass only, the passes before it are cut now. Returns the info of the reset."""
        if machine is not None:
            raise InputError(
                "Part cuts with the machine of its technology: make it with height_mm and tension_share of one value "
                "and randomise=None for one machine"
            )
        family = self.family
        for _ in range(MOST_DRAWS):
            drawn: Drawn = {}
            cut = self._drawn(rng, drawn)
            gauge = np.random.default_rng(int(rng.integers(2**62)))
            one = PartEpisode(family, cut, gauge, float(drawn["tension_share"]))
            if self._prepared(one):
                break
        else:
            raise InputError(f"none of {MOST_DRAWS} machines came to pass {family.only_pass}: draw fewer constants")
        self.episodes[index] = one
        return {"drawn": drawn, "plant_seed": cut.settings.seed, "total_um": cut.total_um}

    def _drawn(self, rng: np.random.Generator, drawn: Drawn) -> PartCut:
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
            cut.cutting_s / family.episode_s, cut.settings.workpiece.greatest_mm / 50.0, one.tension_share,
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
