"""One cut from program file to outputs: `edmsim.cut` and ``edmsim cut``.

Ctrl-C, SIGTERM and SIGHUP (its terminal closes) end it only at points where no work is half done.
"""

import hashlib
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, Protocol, cast

import numpy as np

from edmsim import user_code
from edmsim.controllers import FeedController, SeesTruth, axis, from_text
from edmsim.controllers.axis.elcam.file import NAMES, PLACES, load_tables, read_tables
from edmsim.controllers.axis.elcam.module import Elcam
from edmsim.controllers.mcu.firmware.poscal import unit_um
from edmsim.controllers.planner.registry import position_unit
from edmsim.controllers.protocols import snapshot_text
from edmsim.controllers.pulse_counters import percent_of_window
from edmsim.controllers.user_controllers import check_is_controller
from edmsim.cosim.passes import PassSetup
from edmsim.cosim.simulation import Progress, Simulation
from edmsim.cosim.stops import StopCause
from edmsim.errors import EdmsimError, InputError, located, refuses_wrong_types
from edmsim.files import folder_of, locked
from edmsim.job import checkpoint
from edmsim.job.result import CutResult, Recorders, recorders_for, result_of
from edmsim.job.settings import CutOptions, CutSettings, Running
from edmsim.machine.machine import Machine, constants_digest
from edmsim.machine.options import show
from edmsim.machine.setting import guide_bends
from edmsim.machine.technology import OF_PASS, PassSetting, PassTable, Technology, read_technology, technology_for
from edmsim.plant.axes.drives import parse_fault
from edmsim.plant.constants import screws
from edmsim.plant.window import PlantError
from edmsim.plant.workpiece.height_steps import LowerRegion
from edmsim.program.outline import Corners, Program
from edmsim.program.passes import PassPlan
from edmsim.program.path import Conditions, CutPath, load_program, plan_path
from edmsim.program.taper import GuideHeights
from edmsim.progress import ShownProgress, in_notebook
from edmsim.recording.report import duration_text, outcome_text
from edmsim.signals import NotedSignals, noted

# A cut in passes: what a technology says, put in place of the options that it decides.

_Plan = Callable[[str | Path | Program, CutSettings, Sequence[Machine], PassPlan | None], CutPath]


class Passes(NamedTuple):
    """A cut as a technology sets it."""

    settings: CutSettings  # with the technology's machine, wire, planner and the setting of the rough pass
    path: CutPath
    setups: tuple[PassSetup, ...] = ()  # one per pass; none for a cut in one pass
    approach: PassSetup | None = None
    table: PassTable | None = None  # what the technology says


_OF_PASSES = {"tab_mm": "a tab", "overlap_mm": "an overlap", "after_tab": "what is done before a tab"}
"""Options that have an effect only on passes which the program does not have."""


def with_passes(program: str | Path | Program, settings: CutSettings, plan: _Plan) -> Passes:
    """Plan a cut, in passes where the settings ask for some or the program has some."""
    if settings.passes is None:
        path = plan(program, settings, [settings.load_machine()], None)
        remedy = "say how many, as --passes 4" if path.passes == 1 else "the program has its own, leave it out"
        for name, what in _OF_PASSES.items():
            if getattr(settings, name) != CutSettings.model_fields[name].default:
                raise InputError(f"{what} is for passes: {remedy}")
        if path.conditions.settings:
            return _by_conditions(program, settings, path, plan)
        if path.passes == 1:
            if settings.technology is not None:
                raise InputError(f"a technology is for passes: {remedy}")
            return Passes(settings, path)
        technology = _technology(settings)
        table = _table(settings, technology, path.passes)
        note = f"the program cuts an edge {path.passes} times: these are passes, with the settings of the technology "
        table = table._replace(notices=(f"{note}'{technology.title}'", *table.notices))
        return _in_passes(program, settings, technology, table, PassPlan(table.offsets_mm, of_program=True), plan)
    if settings.conditions is not None:
        raise InputError("conditions set the program's own passes: leave out their table, or the number of passes")
    if settings.offset == "none":
        raise InputError("passes run beside an edge at their offsets: offset none leaves nothing to trim")
    technology = _technology(settings)
    table = _table(settings, technology, settings.passes)
    shift_mm = 0.0 if settings.offset == "auto" else float(settings.offset) - table.offsets_mm[-1]
    offsets_mm = tuple(round(mm + shift_mm, 6) for mm in table.offsets_mm)
    after_tab: Any = settings.after_tab
    pass_plan = PassPlan(offsets_mm, settings.tab_mm, settings.overlap_mm, after_tab)
    return _in_passes(program, settings, technology, table, pass_plan, plan)


def _in_passes(
    program: str | Path | Program, settings: CutSettings, technology: Technology, table: PassTable,
    passes: PassPlan, plan: _Plan,
) -> Passes:
    """Plan a cut in passes, each with its set-up."""
    settings = in_force(settings, technology, table)
    own = technology.material == settings.material
    none = f"there is no technology for {settings.material}, and the settings of '{technology.title}' cannot be used"
    with located(name="" if own else none):
        setups = tuple(setup_of(settings, one) for one in table.settings)
    path = plan(program, settings, [one.machine for one in setups], passes)
    path = replace(path, notices=(*path.notices, *table.notices))
    return Passes(settings, path, setups, approach_of(setups[0].machine, table, table.settings[0]), table)


def _by_conditions(program: str | Path | Program, settings: CutSettings, path: CutPath, plan: _Plan) -> Passes:
    """Give every pass the settings that the user's table has for the program's condition."""
    if settings.technology is not None:
        raise InputError("a technology and a table of conditions both decide the passes: give one of them")
    of_passes = [_with_condition(settings, path.conditions, name) for name in path.conditions.names]
    setups = tuple(_setup(one) for one in of_passes)
    if path.leans:  # where a wire bends follows from the tension of each pass
        path = plan(program, of_passes[0], [one.machine for one in setups], None)
    if path.passes == 1:
        return Passes(of_passes[0], path)
    approach = path.conditions.approach
    lead_in = None if approach is None else _setup(_with_condition(settings, path.conditions, approach))
    return Passes(of_passes[0], path, setups, lead_in)


def _with_condition(settings: CutSettings, conditions: Conditions, name: str | None) -> CutSettings:
    """Return the settings of a cut with what the table says of a condition."""
    if name is None:
        return settings
    found = dict(conditions.settings[name])
    decided: dict[str, Any] = {}
    if "feed_um_s" in found:
        decided["controller"] = f"trim:feed_um_s={found.pop('feed_um_s'):g}"
    if "open_target_share" in found:
        decided["controller"] = f"counts:open_target_share={found.pop('open_target_share'):g}"
    if "tension_N" in found:
        decided["tension"] = found.pop("tension_N")
    for option, value in {**decided, **found}.items():
        usual = CutSettings.model_fields[option].default
        if getattr(settings, option) not in (usual, value):
            raise InputError(f"the table of conditions decides {option} of {name}: leave the option out")
    return settings.model_copy(update={**decided, **found})


def _setup(settings: CutSettings) -> PassSetup:
    controller = settings.controller
    return PassSetup(settings.load_machine(), from_text(controller) if isinstance(controller, str) else controller)


def in_force(settings: CutSettings, technology: Technology, table: PassTable) -> CutSettings:
    """Return settings with what the technology decides, that of its rough pass; refuse what contradicts it."""
    rough = table.settings[0]
    decided: dict[str, Any] = {
        "machine": technology.machine, "wire": technology.wire, "planner": technology.planner,
        "controller": rough.controller(),
        **{name: getattr(rough, own) for name, own in OF_PASS.items()},
    }  # fmt: skip
    for name, value in decided.items():
        chosen, usual = getattr(settings, name), CutSettings.model_fields[name].default
        if chosen not in (usual, value):
            raise InputError(
                f"the technology '{technology.title}' sets {name} to {value!r}, not {chosen!r}: omit the option, "
                "or choose a technology with this value"
            )
    return settings.model_copy(update=decided)


def _technology(settings: CutSettings) -> Technology:
    if settings.technology is not None:
        found = read_technology(settings.technology)
        if found.material != settings.material:
            raise InputError(f"the technology '{found.title}' is for {found.material}, not for {settings.material}")
        return found
    usual = CutSettings.model_fields
    machine, wire = (
        None if getattr(settings, name) == usual[name].default else getattr(settings, name)
        for name in ("machine", "wire")
    )
    return technology_for(settings.material, machine, wire)


def _table(settings: CutSettings, technology: Technology, passes: int) -> PassTable:
    """Return the offsets and settings of a technology, with a notice if it is for another material."""
    height_mm, material = settings.workpiece.greatest_mm, settings.material
    table = technology.table(height_mm, passes)
    if table.resolution not in (None, settings.resolution):
        moved = (
            f"the offsets of the passes were measured at the resolution {table.resolution}; at {settings.resolution} "
            "walls lie elsewhere by some um (edmsim tune technology has the option --resolution)"
        )
        table = table._replace(notices=(*table.notices, moved))
    if technology.material == material:
        return table
    notice = (
        f"there is no technology for {material}: the passes take the settings of '{technology.title}', the material "
        f"most like it; search its own with edmsim tune technology {material} --height {height_mm:g} --passes "
        f"{passes} --out {material}.toml, and cut with --technology {material}.toml"
    )
    return table._replace(notices=(notice, *table.notices))


def setup_of(settings: CutSettings, one: PassSetting) -> PassSetup:
    """Return the set-up of a pass: that of a cut's settings, but for what the pass has of its own."""
    own = {name: getattr(one, of_pass) for name, of_pass in OF_PASS.items()}
    return PassSetup(settings.model_copy(update=own).load_machine(), from_text(one.controller()))


def approach_of(machine: Machine, table: PassTable, rough: PassSetting) -> PassSetup:
    """Return the set-up of a lead-in: the rough pass' machine, at a share of its feed."""
    return PassSetup(machine, from_text(rough.controller(table.approach_share)))


CHECKPOINT_EVERY_S = 60.0  # wall time between checkpoints of a long cut


_Options = ParamSpec("_Options")


class _Cut(Protocol[_Options]):
    """What type checkers know of `cut`: its keywords are those of the class that declares the options."""

    def __call__(self, program: str | Path, *no: _Options.args, **options: _Options.kwargs) -> CutResult: ...


def _takes(options: Callable[_Options, CutOptions]) -> Callable[[Callable[..., CutResult]], _Cut[_Options]]:
    return lambda cut: show(cut, CutOptions)


@_takes(CutOptions)
@refuses_wrong_types
def cut(program: str | Path, **options: Any) -> CutResult:
    """Simulate a part program.

    Parameters
    ----------
    program : path
        G-code (.ngc .nc .gcode .iso .txt) or DXF.
    {options}

    Returns
    -------
    CutResult

    Raises
    ------
    InputError
        If the program or an option cannot be used. No file has been written then.
    EdmsimError
        If the results cannot be written, for example on a full disk. You can resume from the checkpoint.
    KeyboardInterrupt
        On Ctrl-C, SIGTERM or SIGHUP. You can resume from the checkpoint in the folder, if there is one.

    Examples
    --------
    >>> import edmsim
    >>> result = edmsim.cut("examples/punch.ngc", height_mm=10, resolution="fast", max_time_s=5)  # doctest: +SKIP
    >>> result.report["outcome"]  # doctest: +SKIP
    'time-limit'
    """
    running = Running.taken_from(options)
    watch, enter, out = running.watch, running.enter, running.out
    settings, simulation, recorders = _begin(program, CutSettings.model_validate(options))
    made_with = _made_with(program, settings, simulation)
    bar = None if watch or enter or not in_notebook() else CutProgress(ShownProgress(), made_with["program"])
    if bar is not None:
        watch, enter = bar.show, bar.enter
    tell = enter or (lambda _: None)
    folder = None if out is None else folder_of(out)
    if running.resume and running.overwrite:
        raise InputError("you can resume or discard an interrupted cut: choose --resume or --overwrite")
    if running.resume:
        checkpoint.refuse_missing(folder)
    with nullcontext() if folder is None else locked(folder), noted() as signals:
        run = _Run(simulation, folder, {**made_with, "seed": settings.seed}, signals)
        run.begin(running.resume, running.overwrite)
        tell("cutting")
        run.to_the_end(watch)
        tell("measuring")
        notices = _notices(simulation, settings)
        result = result_of(simulation, recorders, settings, made_with, notices, run.wall_time_s)
        if folder is not None:
            run.leave(result, tell)
    if bar is not None:
        bar.enter(outcome_text(result.report))
    return result


def make_controller(choice: str | FeedController) -> FeedController:
    """Return a feed controller for a cut, from its text or as given; see `edmsim.controllers.from_text`."""
    controller = from_text(choice, cutting=True) if isinstance(choice, str) else check_is_controller(choice)
    if isinstance(controller, SeesTruth):
        raise InputError(
            f"the {controller.name} controller looks at the true gap, which no machine shows: it can be compared "
            "with (edmsim evaluate), not cut with"
        )
    return controller


def read_program(program: str | Path, settings: CutSettings) -> Program:
    """Read the program of a cut with these settings; raises as `load_program`."""
    return load_program(
        program, ignore=settings.ignore, layers=settings.layers, unit=settings.unit, offsets=settings.offsets,
        dialect=settings.dialect, conditions=settings.conditions, upper_layer=settings.upper_layer,
    )


def planned(
    program: str | Path | Program, settings: CutSettings, machines: Sequence[Machine], passes: PassPlan | None = None
) -> CutPath:
    """Plan the wire's path of a cut with these settings on a machine, set up pass by pass; raises as `plan_path`."""
    machine, errors_mm = machines[0], settings.guide_errors_mm or (0.0, 0.0)
    table = machine.base.table
    step_um, travel_um = table.step_um.value, round(table.travel_mm.value * 1e3)
    unit = position_unit(settings.planner, travel_um, step_um)
    offset = settings.offset if passes is None or passes.of_program else "auto"
    return plan_path(
        program if isinstance(program, Program) else read_program(program, settings), offset,
        auto_offset_mm=machine.auto_offset_mm, table_um=travel_um, grid_um=unit_um(unit, round(step_um)),
        taper_deg=settings.taper_deg, corners=cast(Corners, settings.taper_corners),
        guides=[guides_of(one, errors_mm) for one in machines], passes=passes,
    )


def guides_of(machine: Machine, errors_mm: tuple[float, float]) -> GuideHeights | None:
    """Return the guides' positions as known to the control; None if the upper guide does not move."""
    travel = machine.base.guides.upper_travel_mm
    if travel is None:
        return None
    bends, (lower_mm, upper_mm) = guide_bends(machine), np.add(machine.guides_z_mm, errors_mm).tolist()
    return GuideHeights(lower_mm, upper_mm, machine.height_mm, travel.value, bends.stiff_mm, bends.radius_mm)


class Prepared(NamedTuple):
    """All inputs of a cut before the simulation; for a cut in passes, with the settings of the technology."""

    settings: CutSettings
    machine: Machine
    controller: FeedController
    path: CutPath
    steps: tuple[LowerRegion, ...]
    drives: dict[str, axis.Drive]
    compensation: Elcam | None
    setups: tuple[PassSetup, ...] = ()
    approach: PassSetup | None = None


def prepared(program: str | Path, settings: CutSettings, plan: _Plan = planned) -> Prepared:
    """Read and check all inputs of a cut, without simulation."""
    found = with_passes(program, settings, plan)
    settings, path = found.settings, found.path
    machine, file = settings.load_machine(), settings.compensation
    controller = make_controller(settings.controller)
    if found.setups:
        machine, controller = found.setups[0]
    steps = settings.workpiece.steps(path, machine.wire_diameter_um)
    step_um = machine.base.table.step_um.value
    drives = {
        name: axis.from_text(settings.drive, axis.Screw(step_um, screw["um_per_rad"]))
        for name, screw in zip("xy", screws(machine).values(), strict=True)
    }
    compensation = None if file is None else load_tables(read_tables(file), file)
    return Prepared(
        settings, machine, controller, path, steps, drives, compensation, found.setups, found.approach
    )


def _begin(program: str | Path, settings: CutSettings) -> tuple[CutSettings, Simulation, Recorders]:
    """Read the program; set up machine, path, controller and recorders; return the settings in force with them."""
    ready = prepared(program, settings)
    settings = ready.settings
    recorders = recorders_for(ready.machine, ready.steps, settings.resolution)
    simulation = Simulation(
        ready.machine, ready.path, ready.controller, planner=settings.planner, seed=settings.seed,
        resolution=settings.resolution, max_time_s=settings.max_time_s, steps=ready.steps,
        mechanics=settings.mechanics, observers=recorders, drives=ready.drives, compensation=ready.compensation,
        stuck_wire_sensor=settings.stuck_wire_sensor, setups=ready.setups, approach=ready.approach,
        axis_faults=[parse_fault(text) for text in settings.axis_faults],
    )
    return settings, simulation, recorders


def _made_with(program: str | Path, settings: CutSettings, simulation: Simulation) -> dict[str, Any]:
    """Return the report's settings: the options, what they come to, and digests of the files they name."""
    machine, path = simulation.machine, simulation.path
    table = machine.base.table
    unit = position_unit(settings.planner, table.travel_mm.value * 1e3, table.step_um.value)
    file = user_code.file_of(settings.controller) if isinstance(settings.controller, str) else None
    tables = settings.compensation
    return {
        "program": Path(program).name.encode("utf-8", "replace").decode(),
        "program_sha256": _digest(Path(program).read_bytes()),
        **settings.model_dump(mode="json", exclude={"seed", "tension", "offset"}),
        **({} if file is None else {"controller_sha256": _digest(Path(file).read_bytes())}),
        **({} if tables is None else {"compensation_sha256": _digest(Path(tables).read_bytes())}),
        **({} if path.passes == 1 else {"passes_sha256": _digest(repr(simulation.described_setups).encode())}),
        "wire_diameter_um": machine.wire_diameter_um, "tension_N": machine.tension, "t_on_us": machine.t_on_us,
        "t_period_us": machine.t_period_us, "position_unit": unit,
        "offset_um": path.offset_um,
        "wire_path_sha256": _digest(b"".join(way.tobytes() for contour in path.contours for way in contour.reach_um)),
        "constants_sha256": constants_digest(machine),
    }


def _notices(simulation: Simulation, settings: CutSettings) -> list[str]:
    """Return what the user should know about a cut that is over."""
    notices = [*simulation.path.notices, *simulation.passes.notices]
    if simulation.refused is not None:
        notices.append(f"the generator refused a setting the controller wanted: {simulation.refused}")
    for name, drive in simulation.plant.drives.items():
        tells = getattr(drive, "why_stopped", None)
        if simulation.cause is StopCause.FINISHED and tells is not None and (why := tells()):
            notices.append(f"the drive of {name} says: {why}")
    for table in [] if simulation.elcam is None else simulation.elcam.tables.values():
        driven, along = NAMES[table.axis], PLACES[table.master]
        if table.held:
            held = "there it holds its end value"
            notices.append(f"the cut went beyond the compensation table of {driven} along {along}: {held}")
        if table.leads:
            notices.append(
                f"the upper guide's axis {driven} followed its cam along {along}: the profile error compares the "
                "wall with the upright one of the program"
            )
    if simulation.missed_windows:
        notices.append(
            f"the counts of {simulation.missed_windows} windows were missed: the controller's routine takes longer "
            "than a window; a longer period leaves it time"
        )
    ended_s = simulation.plant.time_ns * 1e-9
    notices += [
        f"the fault {text} did not happen: the cut was over at {ended_s:.1f} s"
        for text in settings.axis_faults if parse_fault(text).at_s > ended_s
    ]  # fmt: skip
    return notices


class _Run:
    """A cut under way, and what its folder keeps of it: a checkpoint until the results are there."""

    def __init__(
        self, simulation: Simulation, folder: Path | None, made_with: Mapping[str, Any], signals: NotedSignals
    ) -> None:
        self._simulation, self._folder, self._made_with, self._signals = simulation, folder, made_with, signals
        self._before_s = self.wall_time_s = 0.0
        self._saved = time.monotonic()
        self._held_s: float | None = None  # machine time of the checkpoint

    def begin(self, resume: bool, overwrite: bool) -> None:
        """Take up the folder's interrupted cut, or see that there is none to lose."""
        if self._folder is None:
            return
        snapshot_text(self._simulation.controller)  # so that no cut is lost to one that cannot be stored
        if resume:
            self._before_s = self.wall_time_s = checkpoint.load(self._simulation, self._folder, self._made_with)
            self._held_s = self._simulation.plant.time_ns * 1e-9
        elif not overwrite and (self._folder / checkpoint.NAME).exists():
            raise InputError(
                "this folder has an interrupted cut: resume it with --resume, or discard it with --overwrite",
                self._folder,
            )

    def to_the_end(self, watch: Callable[[Progress], None] | None) -> None:
        """Cut; Ctrl-C, SIGTERM and what `watch` raises end it between two windows, behind a checkpoint."""
        started, between = time.monotonic(), False

        def turn(progress: Progress) -> None:
            nonlocal between
            self.wall_time_s, between = self._before_s + time.monotonic() - started, True
            if watch is not None:
                watch(progress._replace(wall_time_s=self.wall_time_s))
            if time.monotonic() - self._saved > CHECKPOINT_EVERY_S and self._simulation.outcome is None:
                self._save()
            self._signals.raise_noted()
            between = False

        try:
            self._simulation.run(turn)
        except PlantError:  # it would come again
            raise
        except BaseException:
            if between:
                self._save()
            else:
                self._tell_unsaved()
            raise
        self._save()
        self._signals.at_once()

    def _tell_unsaved(self) -> None:
        """Say from where a cut can go on that an error, of its controller say, has stopped within a window."""
        if self._folder is not None:
            held_s, none = self._held_s, "from its beginning, as there is no checkpoint"
            at = none if held_s is None else f"at {held_s:.1f} s by --resume"
            warnings.warn(f"{self._folder}: a cut is not saved within a window: it goes on {at}", stacklevel=2)

    def leave(self, result: CutResult, tell: Callable[[str], None]) -> None:
        """Write the results; only then the checkpoint has done its work."""
        assert self._folder is not None
        try:
            result.write(self._folder, tell)
        except OSError as error:
            saved = self._save()
            held = "the checkpoint holds the cut: make room and take it up with --resume"
            raise EdmsimError(
                f"{self._folder}: the results could not be written: {error.strerror or error}; "
                f"{held if saved else 'nor could a checkpoint: the cut is lost'}"
            ) from None
        self._signals.only_note()
        (self._folder / checkpoint.NAME).unlink(missing_ok=True)

    def _save(self) -> bool:
        """Write a checkpoint and say whether there is one; where that fails, the last one stays."""
        if self._folder is None:
            return False
        self._saved = time.monotonic()
        try:
            checkpoint.save(self._simulation, self._folder, self._made_with, self.wall_time_s)
            self._held_s = self._simulation.plant.time_ns * 1e-9
        except (OSError, TypeError, ValueError) as error:  # a law may put into its snapshot what JSON cannot hold
            why = getattr(error, "strerror", None) or error
            warnings.warn(f"{self._folder}: no checkpoint could be written: {why}; the cut goes on", stacklevel=2)
        return (self._folder / checkpoint.NAME).exists()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


_EVERY_S = 0.1  # between two looks at a cut: windows are shorter (ours)


class CutProgress:
    """What `edmsim.cut` calls back, as a bar."""

    def __init__(self, bar: ShownProgress, name: str) -> None:
        self._bar, self._name = bar, name
        self._last: Progress | None = None
        self._drawn_s = 0.0

    def enter(self, phase: str) -> None:
        """Name what is being done from now on, or how it ended."""
        self._draw(phase, at_once=True)

    def show(self, progress: Progress) -> None:
        """Take in a window."""
        self._last = progress
        now = time.monotonic()
        if now < self._drawn_s + _EVERY_S:
            return
        self._drawn_s = now
        short, open_ = percent_of_window(progress.short), percent_of_window(progress.open)
        self._draw(f"{progress.feed_um_s:.1f} um/s, short {short:.0f} %, open {open_:.0f} %")

    def _draw(self, words: str, at_once: bool = False) -> None:
        share, times = 0.0, ""
        if (last := self._last) is not None:
            share = min(1.0, last.path_um / last.total_um)
            within = f" in {duration_text(last.wall_time_s)}" if last.wall_time_s else ""  # test cuts have no clock
            times = f"{duration_text(last.time_s)} simulated{within}, "
        self._bar.show(self._name, share, 1.0, times + words, at_once)
