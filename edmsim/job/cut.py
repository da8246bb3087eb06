"""One cut from program file to outputs: `edmsim.cut` and ``edmsim cut``.

Ctrl-C, SIGTERM and SIGHUP (the terminal closes) end a cut only at points where no work is half done.
"""

import hashlib
import json
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ParamSpec, Protocol

import numpy as np

from edmsim import files, runs, screen, signals, user_code
from edmsim.closed_loop.simulation import Progress, Simulation
from edmsim.controllers import protocols, pulse_counters
from edmsim.controllers.axis.elcam.file import NAMES, PLACES
from edmsim.errors import EdmsimError, InputError, located, refuses_wrong_types
from edmsim.job.options import CutOptions, CutSettings, Running
from edmsim.job.plan import prepared, standing_still
from edmsim.job.result import CutResult, Recorders, recorders_for, result_of
from edmsim.machine import machine, options
from edmsim.metrology.profile import BLANK_EDGE_MM, depth_in_blank
from edmsim.plant.axes.drives import parse_fault
from edmsim.plant.window import PlantError
from edmsim.recording.report import duration_text, outcome_text

CHECKPOINT = "checkpoint.npz"  # file in the output folder, deleted after the results are written
CHECKPOINT_EVERY_S = 60.0  # wall time between checkpoints of a long cut
_FILES = "files"  # entry of a checkpoint's settings: digests of the files that they name, for the refusal of a change
CHECKPOINT_FORMAT = 12  # increased when the contents of a checkpoint change; other formats are refused

_Options = ParamSpec("_Options")


class _Cut(Protocol[_Options]):
    """The type of `cut` for type checkers: its keywords are those of the class that declares the options."""

    def __call__(self, program: str | Path, *no: _Options.args, **options: _Options.kwargs) -> CutResult: ...


def _takes(declared: Callable[_Options, CutOptions]) -> Callable[[Callable[..., CutResult]], _Cut[_Options]]:
    return lambda cut: options.show(cut, CutOptions)


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
    bar = None
    if not (watch or enter) and screen.in_notebook():
        bar = CutProgress(screen.ShownProgress(), made_with["program"])
        watch, enter = bar.show, bar.enter
    tell = enter or (lambda _: None)
    folder = None if out is None else files.folder_of(out)
    if running.resume and running.overwrite:
        raise InputError("you can resume or discard an interrupted cut: choose --resume or --overwrite")
    if running.resume:
        if folder is None:
            raise InputError("to resume a cut, name its folder")
        if not (folder / CHECKPOINT).exists():
            raise InputError("there is no interrupted cut to resume in this folder", folder)
    with files.locked(folder), signals.noted() as pending:
        named = runs.digests_of([str(program), *made_with.values()])
        digests = {Path(file).name: digest for file, digest in named.items()}
        run = _Run(simulation, folder, {**made_with, "seed": settings.seed, _FILES: digests}, pending)
        run.begin(running.resume, running.overwrite)
        tell("cutting")
        with located(user_code.file_of(made_with["controller"])):
            run.to_the_end(watch)
        tell("measuring")
        notices = _notices(simulation, settings)
        result = result_of(simulation, recorders, settings, made_with, notices, run.wall_time_s)
        if folder is not None:
            run.leave(result, tell)
    if bar is not None:
        bar.enter(outcome_text(result.report))
    return result


def _begin(program: str | Path, settings: CutSettings) -> tuple[CutSettings, Simulation, Recorders]:
    """Read the program and set up the simulation; return the settings in force, the simulation and its recorders."""
    ready = prepared(program, settings)
    settings = ready.settings
    still = standing_still(settings.planner, [ready.controller, *(one.controller for one in ready.setups)])
    for notice in still:
        warnings.warn(notice, stacklevel=3)  # now, as such a cut may not end, and in the report
    path = replace(ready.path, notices=(*ready.path.notices, *still))
    lower_regions = settings.workpiece.lower_regions(path, ready.machine.wire_diameter_um)
    recorders = recorders_for(ready.machine, lower_regions, settings.resolution)
    simulation = Simulation(
        ready.machine, path, ready.controller, planner=settings.planner, seed=settings.seed,
        resolution=settings.resolution, max_time_s=settings.max_time_s, lower_regions=lower_regions,
        mechanics=settings.mechanics, recorders=recorders, drives=ready.drives, compensation=ready.compensation,
        stuck_wire_sensor=settings.stuck_wire_sensor, setups=ready.setups, approach=ready.approach,
        axis_faults=[parse_fault(text) for text in settings.axis_faults],
    )
    return settings, simulation, recorders


def _made_with(program: str | Path, settings: CutSettings, simulation: Simulation) -> dict[str, Any]:
    """Return the report's settings: options, values derived from them, and digests of the files that they name."""
    set_up, path, tables = simulation.machine, simulation.path, settings.compensation
    file = user_code.file_of(settings.controller) if isinstance(settings.controller, str) else None
    own_code = None if file is None else [*runs.digests_of([file]).values()]
    return {
        "program": Path(program).name.encode("utf-8", "replace").decode(),
        "program_sha256": _digest(Path(program).read_bytes()),
        **settings.model_dump(mode="json", exclude={"seed", "tension", "offset"}),
        **({} if own_code is None else {"controller_sha256": _digest(repr(own_code).encode())}),
        **({} if tables is None else {"compensation_sha256": _digest(Path(tables).read_bytes())}),
        **({} if path.passes == 1 else {"passes_sha256": _digest(repr(simulation.described_setups).encode())}),
        "wire_diameter_um": set_up.wire_diameter_um, "tension_N": set_up.tension, "t_on_us": set_up.t_on_us,
        "t_period_us": set_up.t_period_us, "position_unit": simulation.unit, "offset_um": path.offset_um,
        "wire_path_sha256": _digest(b"".join(um.tobytes() for contour in path.contours for um in contour.reach_um)),
        "constants_sha256": machine.constants_digest(set_up),
    }


def _notices(simulation: Simulation, settings: CutSettings) -> list[str]:
    """Return notices for the user about a cut that has ended."""
    notices = [*simulation.path.notices, *simulation.passes.notices, *simulation.beyond_training]
    if simulation.refused is not None:
        notices.append(f"the generator refused a setting the controller wanted: {simulation.refused}")
    for name, drive in simulation.plant.drives.items():
        tells = getattr(drive, "why_stopped", None)
        if simulation.outcome == "finished" and tells is not None and (why := tells()):
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
    if simulation.overtaken:
        notices.append(
            f"{simulation.overtaken} feeds of the controller had no effect: the next one came before their latency "
            "was over; a longer period or a smaller latency_s leaves them time"
        )
    if simulation.slowed:
        notices.append(
            f"the wire was slower than its feed in {simulation.slowed} windows: the lower guide has the longer way, "
            f"and the planner {settings.planner} runs it at {simulation.max_feed_um_s:.3g} um/s at most; choose the "
            "planner exact, or a lower feed"
        )
    notices += [
        f"the contour threaded at X {x:.3f} Y {y:.3f} mm on the table lies within {BLANK_EDGE_MM:g} mm of its start "
        "hole, whose rim could be taken for it: its wall is not measured, nor what passes took and their roughness"
        for contour in simulation.path.contours for x, y in contour.points_um[:1] * 1e-3
        if (depth_in_blank(simulation.plant.field.stock, contour.at_mid_height().nominal_mm) < BLANK_EDGE_MM).all()
    ]
    ended_s = simulation.plant.time_ns * 1e-9
    notices += [
        f"the fault {text} did not happen: the cut was over at {ended_s:.1f} s"
        for text in settings.axis_faults if parse_fault(text).at_s > ended_s
    ]  # fmt: skip
    notices += [
        f"the constant {name} had no effect: with steppers only the mechanics mujoco has it"
        for name in _without_effect(simulation, settings)
    ]
    return notices


def _without_effect(simulation: Simulation, settings: CutSettings) -> list[str]:
    """Return the constants set by an option that have no effect, because modal mechanics with steppers omit them."""
    if settings.mechanics != "modal" or simulation.plant.own_step_um:
        return []
    left_out = ["table.friction_N", "table.presliding_um"]
    if not simulation.plant.machine.base.geometry.has_errors:
        left_out.append("table.backlash_um")
    return [name for name, _ in settings.overrides if name in left_out]


class _Run:
    """A running cut, with a checkpoint in its folder until the results are written."""

    def __init__(
        self, simulation: Simulation, folder: Path | None, made_with: Mapping[str, Any], pending: signals.NotedSignals
    ) -> None:
        self._simulation, self._folder, self._made_with, self._signals = simulation, folder, made_with, pending
        self._before_s = self.wall_time_s = 0.0
        self._saved = time.monotonic()
        self._held_s: float | None = None  # machine time of the checkpoint

    def begin(self, resume: bool, overwrite: bool) -> None:
        """Resume the interrupted cut of the folder, or refuse to overwrite it unless `overwrite` is set."""
        if self._folder is None:
            return
        protocols.snapshot_text(self._simulation.controller)  # raises before the cut if the state cannot be saved
        file = self._folder / CHECKPOINT
        if resume:
            self._before_s = self.wall_time_s = load_checkpoint(self._simulation, file, self._made_with)
            self._held_s = self._simulation.plant.time_ns * 1e-9
        elif not overwrite and file.exists():
            raise InputError(
                "this folder has an interrupted cut: resume it with --resume, or discard it with --overwrite",
                self._folder,
            )

    def to_the_end(self, watch: Callable[[Progress], None] | None) -> None:
        """Run the cut; Ctrl-C, SIGTERM and exceptions of `watch` end it between two windows, after a checkpoint."""
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
        except PlantError:  # would be raised again after a resume
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
        """Warn from when the cut can be resumed after an error within a window, for example of its controller."""
        if self._folder is not None:
            held_s = self._held_s
            then = "nothing was saved" if held_s is None else f"--resume continues at {held_s:.1f} s"
            at = f"at {self._simulation.plant.time_ns * 1e-9:.3f} s of machine time, within a window"
            warnings.warn(f"{self._folder}: an error stopped the cut {at}: {then}", stacklevel=2)

    def leave(self, result: CutResult, tell: Callable[[str], None]) -> None:
        """Write the results, then delete the checkpoint."""
        assert self._folder is not None
        try:
            result.write(self._folder, tell)
        except (OSError, InputError) as error:  # InputError: the folder cannot be written to any longer
            saved, why = self._save(), error.reason if isinstance(error, InputError) else error.strerror or error
            held = "the checkpoint holds the cut: when files can be written again, continue with --resume"
            raise EdmsimError(
                f"{self._folder}: the results could not be written: {why}; "
                f"{held if saved else 'nor could a checkpoint: the cut is lost'}"
            ) from None
        self._signals.only_note()
        (self._folder / CHECKPOINT).unlink(missing_ok=True)

    def _save(self) -> bool:
        """Write a checkpoint and return whether there is one; if writing fails, the previous one is kept."""
        if self._folder is None:
            return False
        self._saved, file = time.monotonic(), self._folder / CHECKPOINT
        try:
            save_checkpoint(self._simulation, file, self._made_with, self.wall_time_s)
            self._held_s = self._simulation.plant.time_ns * 1e-9
        except (OSError, TypeError, ValueError) as error:  # JSON cannot represent a controller's snapshot
            why = getattr(error, "strerror", None) or error
            warnings.warn(f"{self._folder}: no checkpoint could be written: {why}; the cut goes on", stacklevel=2)
        return file.exists()


def save_checkpoint(simulation: Simulation, file: Path, settings: Mapping[str, Any], wall_time_s: float) -> None:
    """Write a checkpoint; it replaces the previous one completely or not at all."""
    arrays, values = simulation.snapshot()
    own = {"format": CHECKPOINT_FORMAT, "settings": dict(settings), "values": values, "wall_time_s": wall_time_s}
    text = np.frombuffer(json.dumps(own).encode(), np.uint8)
    with files.replacing(file) as partial, partial.open("wb") as opened:
        np.savez(opened, allow_pickle=False, __json__=text, **arrays)


def load_checkpoint(simulation: Simulation, file: Path, settings: Mapping[str, Any]) -> float:
    """Restore the state of a cut from a checkpoint; return the wall time spent so far.

    Raises `InputError` if the file is damaged, of another version, or of a cut with other settings.
    """
    try:
        arrays = files.read_arrays(file.read_bytes())
        saved = json.loads(arrays.pop("__json__").tobytes())
        if saved.get("format") != CHECKPOINT_FORMAT:
            raise InputError("another version of edmsim wrote the checkpoint; cut again without --resume", file)
        _compare(saved["settings"], settings, file)
        try:
            simulation.restore(arrays, saved["values"])
        except InputError as error:
            raise ValueError(error.reason) from None
        return float(saved["wall_time_s"])
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise InputError(f"the checkpoint is damaged ({error}); cut again without --resume", file) from None


def _compare(stored: Mapping[str, Any], expected: Mapping[str, Any], file: Path) -> None:
    # digests last, because the name and value of a setting are more informative
    for name in sorted((stored.keys() | expected.keys()) - {_FILES}, key=lambda one: (one.endswith("sha256"), one)):
        if _unplaced(stored.get(name)) == _unplaced(expected.get(name)):
            continue
        undo = "undo the change, or use --overwrite"
        if name.endswith("_sha256"):
            what = name.removesuffix("_sha256")
            named = f" {expected[what]}" if isinstance(expected.get(what), str) else ""
            reason, remedy = f"{what.replace('_', ' ')}{named}: not as in the interrupted cut", f"; {undo}"
        else:
            reason = f"the interrupted cut was made with {name} {stored.get(name)!r}, not {expected.get(name)!r}"
            remedy = ""
        now, before = expected.get(_FILES, {}), stored.get(_FILES, {})
        edited = [one for one, found in now.items() if one not in reason and before.get(one, found) != found]
        if edited:
            remedy = f"; {' and '.join(edited)} changed since then: {undo}"
        raise InputError(reason + remedy, file)


def _unplaced(value: Any) -> Any:
    """Return a file's name without its folder, because digests decide whether two files are the same."""
    return Path(value).name if isinstance(value, str) else value


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


_EVERY_S = 0.1  # between two updates of the bar, because windows are shorter (ours)


class CutProgress:
    """The callbacks of `edmsim.cut` that show a progress bar."""

    def __init__(self, bar: screen.ShownProgress, name: str) -> None:
        self._bar, self._name = bar, name
        self._last: Progress | None = None
        self._drawn_s = 0.0

    def enter(self, phase: str) -> None:
        """Show the name of the phase that begins, or the outcome."""
        self._draw(phase, at_once=True)

    def show(self, progress: Progress) -> None:
        """Update the bar after a window."""
        self._last = progress
        now = time.monotonic()
        if now < self._drawn_s + _EVERY_S:
            return
        self._drawn_s = now
        short, open_ = map(pulse_counters.percent_of_window, (progress.short, progress.open))
        self._draw(f"{progress.feed_um_s:.1f} um/s, short {short:.0f} %, open {open_:.0f} %")

    def _draw(self, words: str, at_once: bool = False) -> None:
        share, times = 0.0, ""
        if (last := self._last) is not None:
            share = min(1.0, last.path_um / last.total_um)
            within = f" in {duration_text(last.wall_time_s)}" if last.wall_time_s else ""  # 0 for test cuts
            times = f"{duration_text(last.time_s)} simulated{within}, "
        self._bar.show(self._name, share, 1.0, times + words, at_once)
