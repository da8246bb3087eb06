"""One cut from program file to outputs: what `edmsim.cut` and ``edmsim cut`` do."""

from __future__ import annotations

import hashlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Unpack

from edmsim import user_code
from edmsim.controllers import FeedController, SeesTruth, axis, from_text
from edmsim.controllers.mcu.firmware.poscal import unit_um
from edmsim.controllers.own import check_is_controller
from edmsim.controllers.planner.registry import position_unit
from edmsim.cosim.simulation import Progress, Simulation
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.job import checkpoint
from edmsim.job.recorders import Recorders, recorders_for
from edmsim.job.result import CutResult, result_of
from edmsim.job.settings import CutOptions, CutSettings, takes_settings
from edmsim.machine.files import own_mjcf_text
from edmsim.program.path import plan_path

CHECKPOINT_EVERY_S = 60.0
"""Wall time between checkpoints of a long cut."""


@takes_settings
def cut(
    program: str | Path,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    watch: Callable[[Progress], None] | None = None,
    **options: Unpack[CutOptions],
) -> CutResult:
    """Simulate a part program.

    Parameters
    ----------
    program : path
        G-code (.ngc .nc .gcode .iso) or DXF.
    out : path, optional
        Folder for the outputs; without one nothing is written.
    resume : bool
        Take up the interrupted cut of `out`.
    watch : callable, optional
        Called with a `Progress` after every window.
    {options}

    Returns
    -------
    CutResult

    Raises
    ------
    InputError
        Anything that cannot be used; nothing has been written then.
    KeyboardInterrupt
        After the checkpoint was written, if there is a folder for it.
    """
    settings = CutSettings.model_validate(options)
    simulation, recorders = _begin(program, settings)
    made_with = _made_with(program, settings, simulation)
    folder = None if out is None else Path(out)
    spent_s = _run(simulation, folder, {**made_with, "seed": settings.seed}, resume, watch)
    result = result_of(simulation, recorders, settings, made_with, _notices(simulation, settings), spent_s)
    if folder is not None:
        result.write(folder)
        (folder / checkpoint.NAME).unlink(missing_ok=True)
    return result


def make_controller(given: str | FeedController) -> FeedController:
    """Make a feed controller that a machine could have, or take one; see `edmsim.controllers.from_text`."""
    controller = from_text(given) if isinstance(given, str) else check_is_controller(given)
    if isinstance(controller, SeesTruth):
        raise InputError(
            f"the {controller.name} controller looks at the true gap, which no machine shows: it can be compared "
            "with (edmsim evaluate), not cut with"
        )
    return controller


def _begin(program: str | Path, settings: CutSettings) -> tuple[Simulation, Recorders]:
    """Read the program; set up machine, path, controller and recorders."""
    machine = settings.load_machine()
    controller = make_controller(settings.controller)
    step_um, travel_um = machine.base.table.step_um.value, round(machine.base.table.travel_mm.value * 1e3)
    unit = position_unit(settings.planner, travel_um, step_um)
    path = plan_path(
        program, settings.offset, auto_offset_mm=machine.auto_offset_mm, table_um=travel_um,
        grid_um=unit_um(unit, round(step_um)),
    )
    steps = settings.workpiece.steps(path, machine.wire_diameter_um)
    recorders = recorders_for(machine, steps, settings.resolution)
    simulation = Simulation(
        machine, path, controller, planner=settings.planner, seed=settings.seed, resolution=settings.resolution,
        max_time_s=settings.max_time_s, steps=steps, mechanics=settings.mechanics, observers=recorders,
        drives={name: axis.from_text(settings.drive) for name in "xy"},
    )
    return simulation, recorders


def _made_with(program: str | Path, settings: CutSettings, simulation: Simulation) -> dict[str, Any]:
    """Return the report's settings: the options, what they come to, and digests of the files they name."""
    machine, path = simulation.machine, simulation.path
    table = machine.base.table
    unit = position_unit(settings.planner, table.travel_mm.value * 1e3, table.step_um.value)
    file = user_code.named(settings.controller) if isinstance(settings.controller, str) else None
    return {
        "program": Path(program).name, "program_sha256": _digest(Path(program).read_bytes()),
        **settings.model_dump(mode="json", exclude={"seed", "tension", "offset"}),
        **({} if file is None else {"controller_sha256": user_code.digest(file.file)}),
        "wire_diameter_um": machine.wire_diameter_um, "tension_N": machine.tension, "t_on_us": machine.t_on_us,
        "t_period_us": machine.t_period_us, "position_unit": unit,
        "offset_um": path.offset_um,
        "constants_sha256": _digest((machine.model_dump_json() + own_mjcf_text(machine.base.model)).encode()),
    }


def _notices(simulation: Simulation, settings: CutSettings) -> list[str]:
    """Return what the user should know about a cut that is over."""
    notices = [*simulation.path.notices, *settings.workpiece.notices(simulation.plant.resolution.slices)]
    if simulation.refused is not None:
        notices.append(f"the generator refused a setting the controller wanted: {simulation.refused}")
    if simulation.missed_windows:
        notices.append(
            f"the counts of {simulation.missed_windows} windows were missed: the controller's routine takes longer "
            "than a window; a longer period leaves it time"
        )
    return notices


def _run(
    simulation: Simulation, folder: Path | None, made_with: dict[str, Any], resume: bool,
    watch: Callable[[Progress], None] | None,
) -> float:
    """Run to the end with checkpoints; returns the wall time spent."""
    before_s = 0.0
    if resume:
        if folder is None:
            raise InputError("to resume a cut, name its folder")
        before_s = checkpoint.load(simulation, folder, made_with)
    if folder is not None:
        make_writable(folder)
    started = saved = time.monotonic()

    with _ctrl_c_between_windows() as pressed:

        def turn(progress: Progress) -> None:
            nonlocal saved
            if watch is not None:
                watch(progress)
            now = time.monotonic()
            if folder is not None and now - saved > CHECKPOINT_EVERY_S and simulation.outcome is None:
                checkpoint.save(simulation, folder, made_with, before_s + now - started)
                saved = now
            if pressed.is_set():
                raise KeyboardInterrupt

        try:
            simulation.run(turn)
        except KeyboardInterrupt:
            if folder is not None:
                checkpoint.save(simulation, folder, made_with, before_s + time.monotonic() - started)
            raise
    return before_s + time.monotonic() - started


@contextmanager
def _ctrl_c_between_windows() -> Iterator[threading.Event]:
    """Note Ctrl-C in an event: raised within a window, it would leave plant, sums and table at different windows."""
    pressed = threading.Event()

    def press(number: int, frame: FrameType | None) -> None:
        pressed.set()

    # a handler that is not Python's own is the caller's affair, and only the main thread may set one
    ours = threading.current_thread() is threading.main_thread()
    ours = ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
