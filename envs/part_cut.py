"""A cut in passes that waits before every pass for a decision."""

import math
from dataclasses import fields, replace
from typing import NamedTuple

from edmsim.cosim.passes import PassSetup, Sums
from edmsim.cosim.simulation import Simulation
from edmsim.cosim.stops import StopCause
from edmsim.errors import InputError
from edmsim.geometry import arc_lengths
from edmsim.job.plan import approach_of, planned, setup_of, with_passes
from edmsim.job.result import pass_figures
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.technology import PassSetting, PassTable
from edmsim.metrology.kerf import WallError
from edmsim.metrology.profile import error_stats, profile_error
from edmsim.metrology.roughness import roughness_um
from edmsim.plant.window import PlantError
from edmsim.program.outline import Program
from edmsim.program.passes import PassPlan
from edmsim.program.path import CutPath


class Choice(NamedTuple):
    """What is decided of a pass, against the technology's; these are its own constants."""

    set_point: float = 1.0  # factor of the rough pass' share of open pulses, of a trim's feed
    pause: float = 1.0  # factor of the pause between two pulses
    on_time: float = 1.0  # factor of the on-time
    offset_um: float = 0.0  # added to the offset


class Step(NamedTuple):
    """What a step did: a pass, or the part of one up to a broken wire or behind it."""

    sums: Sums  # pulses and energy
    seconds: float  # of cutting: the time for threading is not in it
    travel_um: float  # length of path
    face_mm2: float  # of the part's face, cut by the rough pass; the trims cut it again, and that does not count
    broke: bool  # whether it ended by a broken wire


class PartCut:
    """One part under way: a program of one contour, with `passes` and drawn constants, up to `stops_after`."""

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
        self.number, self.wires_lost = 1, 0  # of the pass decided on next
        self.setting, self.offset_um = rows[0], found.table.offsets_mm[0] * 1e3  # of the last pass, as its offset
        # why the last choice was not made as asked for; empty where it was
        self.cause, self.refused = StopCause.RUNNING, ""
        self.settings, self._path, self._stops_after = found.settings, found.path, stops_after or len(rows)
        self._offsets_mm = list(found.table.offsets_mm)
        self._setups = [setup_of(found.settings, one) for one in rows]
        self._threaded_ns = 0

    @property
    def passes(self) -> int:
        """How many passes there are, rough and trims."""
        return len(self._setups)

    def begin_count(self) -> None:
        """Count time of cutting and lost wires from here on."""
        self.wires_lost = 0
        if self.simulation is not None:
            self._threaded_ns = self.simulation.plant.time_ns

    @property
    def path(self) -> CutPath:
        """The path as it is planned now."""
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
        """Whether the rest of a pass is decided on next, as its wire broke."""
        return self.cause is StopCause.WIRE_BREAK

    @property
    def total_um(self) -> float:
        """Length of the whole path."""
        if self.simulation is not None:
            return self.simulation.total_um
        return sum(float(arc_lengths(one.points_um)[-1]) for one in self._path.contours[0].passes)

    @property
    def path_um(self) -> float:
        """Length of path behind the wire."""
        return 0.0 if self.simulation is None else self.simulation.path_um

    @property
    def time_s(self) -> float:
        """Machine time."""
        return 0.0 if self.simulation is None else self.simulation.plant.time_ns * 1e-9

    @property
    def cutting_s(self) -> float:
        """Machine time without that for threading."""
        return self.time_s - self._threaded_ns * 1e-9

    @property
    def rest_share(self) -> float:
        """Share that is left of the leg that is decided on: 1, but where a wire broke."""
        if self.simulation is None or not self.broken:
            return 1.0
        simulation = self.simulation
        along_um = simulation.legs[simulation.leg].along_um
        done_um = simulation.path_um - simulation.leg_from_um
        return min(max(1.0 - done_um / float(along_um[-1] - along_um[0]), 0.0), 1.0)

    def target_um(self, number: int) -> int:
        """Return the metal that a pass is to leave on the drawing, by the technology."""
        offset_mm, setting = self.table.offsets_mm[number - 1], self.table.settings[number - 1]
        return round(offset_mm * 1e3) - round(setting.last_offset_um)

    def wall(self, number: int) -> WallError | None:
        """Return the wall that a pass of the profile left; None before it is over, or where none was measured."""
        records = [] if self.simulation is None else self.simulation.passes.records
        walls = [one.wall for one in records if one.number == number and one.piece == "profile"]
        return walls[0] if walls and walls[0] is not None and walls[0].places else None

    def run(self, choice: Choice, until_s: float) -> Step:
        """Cut until the next decision, or until so much time of cutting is over."""
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
        way_um, cut_mm2 = self.path_um - before_um, self._face_mm2() - before_mm2
        return Step(Sums(**less), self.cutting_s - before_s, way_um, cut_mm2, self.broken)

    def _face_mm2(self) -> float:
        records = [] if self.simulation is None else self.simulation.passes.records
        cut_um = sum(one.end_um - one.begin_um for one in records if one.number == 1)
        return cut_um * 1e-3 * self.settings.workpiece.greatest_mm

    def _sums(self) -> Sums:
        return Sums() if self.simulation is None else replace(self.simulation.sums)

    def _goes_on(self) -> bool:
        """Say whether the next pass is one of the tab, which follows by itself; else it is decided on, or the end."""
        assert self.simulation is not None
        if self.number == self.passes == self._stops_after:
            return True
        if self.number == self._stops_after:
            self.simulation.cause = StopCause.FINISHED
        else:
            self.number += 1
        return False

    def _begin(self, choice: Choice) -> None:
        """Go on from where the last step ended, as the choice has it."""
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
            steps=settings.workpiece.steps(path, setup.machine.wire_diameter_um), waits=True,
            approach=approach_of(setup.machine, self.table, self.setting),
        )  # fmt: skip

    def _chosen(self, number: int, choice: Choice) -> PassSetup:
        """Return the set-up of a choice; where the generator refuses it, with the technology's pause, then pulses."""
        self.refused = ""
        for tried in (choice, choice._replace(pause=1.0), choice._replace(pause=1.0, on_time=1.0)):
            self.setting = _changed(self.table.settings[number - 1], tried)
            try:
                return setup_of(self.settings, self.setting)
            except InputError as error:
                self.refused = self.refused or str(error)
        raise InputError(f"the technology's setting of pass {number} is refused: {self.refused}")

    def _planned(self, number: int, shift_um: float) -> CutPath:
        """Plan the passes with another offset of the one to come; none is beyond that of the pass before."""
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
        except InputError as error:  # a slot too narrow for the wire so far from its wall
            self.refused = self.refused or str(error)
        self._offsets_mm = [one.offset_um * 1e-3 for one in self.path.contours[0].passes[: self.passes]]
        self.offset_um = self._offsets_mm[number - 1] * 1e3
        return self.path

    def error_um(self) -> float:
        """Return the part's error, root mean square over contour and height; of a single pass that of its wall."""
        simulation = self.simulation
        assert simulation is not None
        if self._stops_after == self.passes:
            return error_stats(profile_error(simulation.plant.field, simulation.path.contours[0]).error_um)["rms"]
        wall = self.wall(self._stops_after)
        return math.nan if wall is None else math.hypot(wall.mean_um - self.target_um(self._stops_after), wall.rms_um)

    def ra_um(self) -> float:
        """Return Ra of the face behind the last pass of the profile; by its craters where it has no wall."""
        assert self.simulation is not None
        figures = [one for one in pass_figures(self.simulation) if one.piece == "profile"]
        if figures[-1].ra_um is not None:
            return figures[-1].ra_um
        sums = next(one.sums for one in self.simulation.passes.records[::-1] if one.piece == "profile")
        flatness = self._setups[0].machine.base.discharge.crater_flatness.value
        return roughness_um(sums.crater_um3 / max(sums.spark + sums.arc, 1), flatness)


def _changed(one: PassSetting, choice: Choice) -> PassSetting:
    """Return a setting of the technology as a choice has it."""
    more_us = one.t_on_us * (choice.on_time - 1.0)
    longer_us = (one.t_period_us - one.t_on_us) * (choice.pause - 1.0)
    changes = {"t_on_us": one.t_on_us + more_us, "t_period_us": one.t_period_us + more_us + longer_us}
    if one.feed == "adaptive":
        changes["open_target_share"] = min(one.open_target_share * choice.set_point, 1.0)
    else:
        changes["feed_mm_min"] = one.feed_mm_min * choice.set_point
    return one.model_copy(update=changes)
