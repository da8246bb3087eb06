"""Part: a cut that waits for a decision before every pass; its machine, draws and reward; and parts in parallel."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.closed_loop.passes import PassRecord, PassSetup, Sums
from edmsim.closed_loop.simulation import Simulation
from edmsim.closed_loop.stops import WORDS, StopCause
from edmsim.envs.arguments import Range, argument, check_kinds, ends_of, record_of_arguments
from edmsim.envs.observation import Entry
from edmsim.envs.reward import WeightsOfTerms
from edmsim.envs.task import Drawn, EnvArguments, names_of
from edmsim.errors import InputError
from edmsim.geometry import Floats, arc_lengths
from edmsim.job.options import CutSettings
from edmsim.job.plan import approach_of, planned, setup_of, with_passes
from edmsim.job.result import pass_figures
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import values_of
from edmsim.machine.setting import MOST_TIME_S, check_height, open_V
from edmsim.machine.technology import PassSetting, PassTable, Technology, machine_of, read_technology
from edmsim.metrology.kerf import WallError
from edmsim.metrology.profile import error_stats, profile_error
from edmsim.metrology.roughness import roughness_um
from edmsim.numeric import above_zero, whole_within, within
from edmsim.plant.resolution import resolution
from edmsim.plant.window import PlantError
from edmsim.program.outline import Program
from edmsim.program.passes import PassPlan
from edmsim.program.path import CutPath, load_program


class Choice(NamedTuple):
    """Decisions on a pass, relative to the technology; the defaults are the technology's own settings."""

    set_point: float = 1.0  # factor of the rough pass' share of open pulses, of a trim's feed
    pause: float = 1.0  # factor of the pause between two pulses
    on_time: float = 1.0  # factor of the on-time
    offset_um: float = 0.0  # added to the offset


class Step(NamedTuple):
    """Result of a step: a pass, or the part of one before or after a wire break."""

    sums: Sums  # pulses and energy
    seconds: float  # time of cutting, without threading
    travel_um: float  # length of path
    face_mm2: float  # face of the part that the rough pass cut; trims, which cut it again, do not count
    broke: bool  # whether it ended because the wire broke


class PartCut:
    """A part in progress: a program of one contour, cut in passes with drawn constants, up to pass `stops_after`."""

    def __init__(
        self, program: Program, settings: CutSettings, tension_share: float, stops_after: int | None = None
    ) -> None:
        self._program = program
        found = with_passes(program, settings)
        assert found.table is not None
        if len(found.path.contours) != 1:
            raise InputError(f"the program has {len(found.path.contours)} contours: a part has one", program.source)
        rows = [
            one.model_copy(update={"tension_N": setup.machine.tension * tension_share})
            for one, setup in zip(found.table.settings, found.setups, strict=True)
        ]
        self.table: PassTable = found.table._replace(settings=tuple(rows))
        self.simulation: Simulation | None = None  # None before the first step
        self.number, self.wires_lost = 1, 0  # `number` is the pass of the next decision
        self.setting, self.offset_um = rows[0], found.table.offsets_mm[0] * 1e3  # of the last pass
        # `refused`: why the last choice was changed; empty if it was not
        self.cause, self.refused = StopCause.RUNNING, ""
        self.settings, self._path, self._stops_after = found.settings, found.path, stops_after or len(rows)
        self._offsets_mm = list(found.table.offsets_mm)
        self._setups = [setup_of(found.settings, one) for one in rows]
        self._threaded_ns = 0

    @property
    def passes(self) -> int:
        """Number of passes, rough and trims."""
        return len(self._setups)

    def begin_count(self) -> None:
        """Start to count time of cutting and lost wires."""
        self.wires_lost = 0
        if self.simulation is not None:
            self._threaded_ns = self.simulation.plant.time_ns

    @property
    def path(self) -> CutPath:
        """The path by its latest plan."""
        return self._path if self.simulation is None else self.simulation.path

    @property
    def machine(self) -> Machine:
        """The set-up of the rough pass."""
        return self._setups[0].machine

    @property
    def over(self) -> bool:
        """Whether the part is cut."""
        return self.cause is StopCause.FINISHED

    @property
    def broken(self) -> bool:
        """Whether the wire broke, so the next decision is on the rest of its pass."""
        return self.cause is StopCause.WIRE_BREAK

    @property
    def total_um(self) -> float:
        """Length of the whole path."""
        if self.simulation is not None:
            return self.simulation.total_um
        return sum(float(arc_lengths(one.points_um)[-1]) for one in self._path.contours[0].passes)

    @property
    def path_um(self) -> float:
        """Path length the wire has travelled."""
        return 0.0 if self.simulation is None else self.simulation.path_um

    @property
    def time_s(self) -> float:
        """Machine time."""
        return 0.0 if self.simulation is None else self.simulation.plant.time_ns * 1e-9

    @property
    def cutting_s(self) -> float:
        """Machine time without threading, since `begin_count`."""
        return self.time_s - self._threaded_ns * 1e-9

    @property
    def rest_share(self) -> float:
        """Remaining share of the leg of the next decision: 1 unless a wire broke."""
        if self.simulation is None or not self.broken:
            return 1.0
        simulation = self.simulation
        along_um = simulation.legs[simulation.leg].along_um
        done_um = simulation.path_um - simulation.leg_from_um
        return min(max(1.0 - done_um / float(along_um[-1] - along_um[0]), 0.0), 1.0)

    def target_um(self, number: int) -> int:
        """Return the thickness of metal that the technology lets a pass leave on the drawing."""
        offset_mm, setting = self.table.offsets_mm[number - 1], self.table.settings[number - 1]
        return round(offset_mm * 1e3) - round(setting.last_offset_um)

    @property
    def _records(self) -> list[PassRecord]:
        """Records of the passes so far."""
        return [] if self.simulation is None else self.simulation.passes.records

    def wall(self, number: int) -> WallError | None:
        """Return the wall that a pass of the profile left; None before its end, or if the wall was not measured."""
        walls = [one.wall for one in self._records if one.number == number and one.piece == "profile"]
        return walls[0] if walls and walls[0] is not None and walls[0].places else None

    def run(self, choice: Choice, until_s: float) -> Step:
        """Cut until the next decision, or until the time of cutting is `until_s`."""
        before, before_s, before_um, before_mm2 = self._sums(), self.cutting_s, self.path_um, self._face_mm2()
        self._begin(choice)
        simulation = self.simulation
        assert simulation is not None
        until_ns = round(until_s * 1e9) + self._threaded_ns
        while simulation.plant.time_ns < until_ns:
            try:
                simulation.step()
            except PlantError:
                simulation.cause = StopCause.OUT_OF_RANGE
            if simulation.waiting and self._goes_on():
                simulation.begin_pass(simulation.path, self._setups)
            if simulation.waiting or simulation.cause is not StopCause.RUNNING:
                break
        self.cause = simulation.cause
        self.wires_lost += self.broken
        now = self._sums()
        less = {f.name: getattr(now, f.name) - getattr(before, f.name) for f in fields(Sums)}
        cut_um, cut_mm2 = self.path_um - before_um, self._face_mm2() - before_mm2
        return Step(Sums(**less), self.cutting_s - before_s, cut_um, cut_mm2, self.broken)

    def _face_mm2(self) -> float:
        cut_um = sum(one.end_um - one.begin_um for one in self._records if one.number == 1)
        return cut_um * 1e-3 * self.settings.workpiece.greatest_mm

    def _sums(self) -> Sums:
        return Sums() if self.simulation is None else replace(self.simulation.sums)

    def _goes_on(self) -> bool:
        """Return whether a pass of the tab follows, without a decision; if not, take the next pass or end the cut."""
        assert self.simulation is not None
        if self.number == self.passes == self._stops_after:
            return True
        if self.number == self._stops_after:
            self.simulation.cause = StopCause.FINISHED
        else:
            self.number += 1
        return False

    def _begin(self, choice: Choice) -> None:
        """Continue from the end of the last step, with the settings of the choice."""
        simulation, settings = self.simulation, self.settings
        number = self.number
        if simulation is not None and self.broken:
            one = simulation.legs[simulation.leg].cut_pass
            number = number if one is None else one.number
        setup = self._chosen(number, choice)
        self._setups[number - 1] = setup
        if simulation is not None and self.broken:
            before_ns = simulation.plant.time_ns
            simulation.rethread(setup, approach_of(setup.machine, self.table, self.setting))
            self._threaded_ns += simulation.plant.time_ns - before_ns
            self.cause = StopCause.RUNNING
            return
        path = self._planned(number, choice.offset_um)
        if simulation is not None:
            simulation.begin_pass(path, self._setups)
            return
        self.simulation = Simulation(
            setup.machine, path, setup.controller, planner=settings.planner, seed=settings.seed,
            resolution=settings.resolution, mechanics=settings.mechanics, setups=self._setups,
            lower_regions=settings.workpiece.lower_regions(path, setup.machine.wire_diameter_um), waits=True,
            approach=approach_of(setup.machine, self.table, self.setting),
        )  # fmt: skip

    def _chosen(self, number: int, choice: Choice) -> PassSetup:
        """Return the set-up of a choice; if it is refused, that with the technology's pause, or also its on-time."""
        self.refused = ""
        for tried in (choice, choice._replace(pause=1.0), choice._replace(pause=1.0, on_time=1.0)):
            self.setting = _changed(self.table.settings[number - 1], tried)
            try:
                return setup_of(self.settings, self.setting)
            except InputError as error:
                self.refused = self.refused or str(error)
        raise InputError(f"the technology's setting of pass {number} is refused: {self.refused}")

    def _planned(self, number: int, shift_um: float) -> CutPath:
        """Plan the path with the next pass's offset shifted; no offset may exceed that of the pass before."""
        target_mm = self.table.offsets_mm[number - 1] + round(shift_um) * 1e-3
        before_mm = self._offsets_mm[number - 2] if number > 1 else math.inf
        self._offsets_mm[number - 1] = round(min(target_mm, before_mm), 6)
        self.offset_um = self._offsets_mm[number - 1] * 1e3
        later = [min(mm, self._offsets_mm[number - 1]) for mm in self.table.offsets_mm[number:]]
        offsets_mm = (*self._offsets_mm[:number], *later)
        settings = self.settings
        if offsets_mm == self.table.offsets_mm:
            return self._path
        plan = PassPlan(offsets_mm, settings.tab_mm, settings.overlap_mm, "stop")
        try:
            return planned(self._program, settings, [one.machine for one in self._setups], plan)
        except InputError as error:  # a slot that is too narrow for the wire at this offset
            self.refused = self.refused or str(error)
        self._offsets_mm = [one.offset_um * 1e-3 for one in self.path.contours[0].passes[: self.passes]]
        self.offset_um = self._offsets_mm[number - 1] * 1e3
        return self.path

    def error_um(self) -> float:
        """Return the part's rms error over contour and height, or that of its wall if the last pass is not cut."""
        simulation = self.simulation
        assert simulation is not None
        if self._stops_after == self.passes:
            return error_stats(profile_error(simulation.plant.field, simulation.path.contours[0]).error_um)["rms"]
        wall = self.wall(self._stops_after)
        return math.nan if wall is None else math.hypot(wall.mean_um - self.target_um(self._stops_after), wall.rms_um)

    def ra_um(self) -> float:
        """Return Ra of the face after the last pass of the profile; from its craters if no wall was measured."""
        assert self.simulation is not None
        figures = [one for one in pass_figures(self.simulation) if one.piece == "profile"]
        if figures[-1].ra_um is not None:
            return figures[-1].ra_um
        sums = next(one.sums for one in self.simulation.passes.records[::-1] if one.piece == "profile")
        flatness = self._setups[0].machine.base.discharge.crater_flatness.value
        return roughness_um(sums.crater_um3 / max(sums.spark + sums.arc, 1), flatness)


def _changed(one: PassSetting, choice: Choice) -> PassSetting:
    """Return a setting of the technology with the changes of a choice."""
    more_us = one.t_on_us * (choice.on_time - 1.0)
    longer_us = (one.t_period_us - one.t_on_us) * (choice.pause - 1.0)
    changes = {"t_on_us": one.t_on_us + more_us, "t_period_us": one.t_period_us + more_us + longer_us}
    if one.feed == "adaptive":
        changes["open_target_share"] = min(one.open_target_share * choice.set_point, 1.0)
    else:
        changes["feed_mm_min"] = one.feed_mm_min * choice.set_point
    return one.model_copy(update=changes)


ACTIONS = {
    "set_point": ("share of open pulses of the rough pass, or feed of a trim, log2", "``set_point_octaves``"),
    "pause": ("pause between two pulses, log2", "``pause_octaves``"),
    "on_time": ("on-time, log2", "``on_time_octaves``"),
    "offset": ("offset from the drawing, um; above 0 farther from the part", "``offset_um``"),
}
"""Entries of an action with their meaning and the unit of 1; 0 is the technology's setting."""
LEFT_UM = 20.0
"""Metal left beyond the target for which its entry is 1 (ours: five times the error of a part)."""
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
"""Entries of an observation; the first eight, and the last action, are of the last step, 0 before the first."""
MOST_OFFSET_UM = 50.0
"""Greatest change of an offset (ours: the stock of a trim)."""
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


TERMS = tuple(f.name for f in fields(PartWeights))  # names of the reward's terms, in the order of their weights


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
    and an effect and are not set by the operator (see `draws`).
    """

    resolution: str = argument("fast", "", "resolution of the plant: fast, default, fine")
    program: str | Path | None = argument(None, "", "G-code or DXF of a contour; None: a punch of 1.6 x 0.4 mm")
    technology: str | Path = argument("tool-steel-brass-254", "", "a name under models/technologies, or a file")
    passes: int = argument(4, "", "number of passes, rough and trims, 2 or more")
    only_pass: int | None = argument(None, "", "pass that is the episode; None: all passes")
    tab_mm: float = argument(0.6, "mm", "length of the edge that holds the part; 0: none")
    # ours: around the height of the shop's table, within the heights of the technology
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
    policy_arguments: ClassVar[tuple[str, ...]] = (
        "set_point_octaves", "pause_octaves", "on_time_octaves", "offset_um", "wires", "episode_s",
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Raise `InputError` for a value that cannot be used, before anything is built."""
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
        # refuse the greatest values that can be drawn here, and not at a reset
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
"""Most draws of a machine until one accepts the technology's settings (ours)."""


NO_STEP = Step(Sums(), 0.0, 0.0, 0.0, False)
"""Result before the first step."""


@dataclass
class PartEpisode:
    """An episode, and the results of its last step."""

    family: Part  # its arguments
    cut: PartCut
    random: np.random.Generator  # for the draws during the episode: the gauge's errors
    tension_share: float
    step: Step = NO_STEP
    action: Floats = field(default_factory=lambda: np.zeros(len(ACTIONS)))
    number: int = 0  # pass that was cut
    # measured metal left, less its target; NaN if it was not measured
    left_um: float = math.nan
    terms: dict[str, float] = field(default_factory=lambda: dict.fromkeys(TERMS, 0.0))  # of the reward
    # error_um, ra_um: of the whole part, NaN before its end
    cost: float = 0.0
    error_um: float = math.nan
    ra_um: float = math.nan

    @property
    def ended(self) -> bool:
        """Whether the episode has terminated."""
        return self.cut.cause is not StopCause.RUNNING and not self.goes_on

    @property
    def goes_on(self) -> bool:
        """Whether a wire broke and another is left."""
        return self.cut.broken and self.cut.wires_lost < self.family.wires

    @property
    def late(self) -> bool:
        """Whether the time limit is reached, in whole nanoseconds as in `PartCut.run`."""
        return round(self.cut.cutting_s * 1e9) >= round(self.family.episode_s * 1e9)


class Parts:
    """Parts of one environment, cut in parallel by `threads` threads; the counterpart of `Batch`."""

    def __init__(self, family: Part, count: int, threads: int = 1) -> None:
        self.family = family
        self.episodes: list[PartEpisode | None] = [None] * count
        self._threads = min(threads, count)
        self._pool: ThreadPoolExecutor | None = None

    def change(self, family: EnvArguments) -> None:
        """Use other arguments in the episodes that begin after this call."""
        assert isinstance(family, Part)
        self.family = family

    # --- beginning ---

    def begin(self, index: int, rng: np.random.Generator, machine: Machine | None, *, redraw: bool) -> dict[str, Any]:
        """Begin an episode and return the info of the reset; if it is one pass, cut the passes before it first."""
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
        """Draw a machine that accepts the settings of the technology."""
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
        """Cut the passes before the episode's with the technology's settings; return whether they were finished."""
        cut, only = one.cut, one.family.only_pass
        while only is not None and cut.number < only:
            self._cut(one, np.zeros(len(ACTIONS)))
            if one.ended or one.late:
                return False
        cut.begin_count()
        return True

    # --- a step ---

    def clear(self) -> None:
        """Set the rewards and costs of the last step to 0."""
        for one in self.episodes:
            if one is not None:
                one.terms, one.cost = dict.fromkeys(TERMS, 0.0), 0.0

    def step(self, active: NDArray[np.int64], actions: NDArray[np.float32]) -> Floats:
        """Cut a pass in the active sub-environments, or the rest of one."""
        self.clear()
        jobs = [(self.episode(int(k)), np.clip(actions[k].astype(np.float64), -1.0, 1.0)) for k in active]
        if self._threads > 1 and len(jobs) > 1:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(self._threads)
            list(self._pool.map(self._step_one, *zip(*jobs, strict=True)))
        else:
            for job in jobs:
                self._step_one(*job)
        names = self.family.objectives or TERMS
        terms = np.array([[0.0 if one is None else one.terms[name] for name in names] for one in self.episodes])
        return terms if self.family.objectives else np.asarray(terms.sum(axis=1))

    def episode(self, index: int) -> PartEpisode:
        """Return the present episode of a sub-environment."""
        one = self.episodes[index]
        assert one is not None
        return one

    def _step_one(self, one: PartEpisode, action: Floats) -> None:
        self._cut(one, action)
        self._pay(one)

    def _cut(self, one: PartEpisode, action: Floats) -> None:
        """Cut a pass, and measure its wall with the gauge's error."""
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
        """Compute the reward's terms and the cost of a step."""
        cut, weights = one.cut, one.family.reward_weights
        one.terms["time"] = -weights.time * one.step.seconds / 60.0
        if one.step.broke:
            threading_s = one.family.base.base.table.threading_s.value
            one.terms["wire_break"] = -weights.wire_break * threading_s / 60.0
            one.cost = 1.0
        if cut.cause is StopCause.FINISHED:
            one.error_um, one.ra_um = cut.error_um(), cut.ra_um()
            for name, value in (("error", one.error_um), ("roughness", one.ra_um)):
                one.terms[name] = -getattr(weights, name) * (value if math.isfinite(value) else 0.0)
        elif one.ended:
            one.terms["limit"] = -weights.limit
            one.cost = 1.0

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Which episodes (n,) have terminated."""
        return np.array([one is not None and one.ended for one in self.episodes])

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which sub-environments (n,) have reached the time limit of an episode."""
        return np.array([one is not None and one.late for one in self.episodes])

    # --- what is shown ---

    def observations(self) -> NDArray[np.float32]:
        """Return every sub-environment's observation, in a new array; 0 if no episode has begun."""
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
        """Return the infos of a step, in new arrays (n,); -1 for an unknown error or Ra.

        Texts are the reasons of an episode's end and of a setting that the generator refused, or empty.
        """
        episodes = [self.episode(k) for k in range(len(self.episodes))]
        rows = [self._info(one) for one in episodes]
        return {
            **{name: np.array([row[name] for row in rows]) for name in rows[0]},
            "reward_terms": {name: np.array([one.terms[name] for one in episodes]) for name in TERMS},
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
        """Return the state of a copy, which starts its own threads."""
        return {**self.__dict__, "_pool": None}
