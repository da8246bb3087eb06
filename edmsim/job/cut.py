"""One cut from program file to outputs: what `edmsim.cut` and ``edmsim cut`` do."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmsim import __version__, user_code
from edmsim.controllers import FeedController, SeesTruth, from_text
from edmsim.controllers.mcu.firmware.poscal import UNIT_UM, unit_for
from edmsim.controllers.own import check_is_controller, text_of
from edmsim.cosim.simulation import Progress, Simulation
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.job import checkpoint
from edmsim.machine.machine import Machine
from edmsim.metrology.edges import contour
from edmsim.metrology.inspection import inspect, totals
from edmsim.plant.mechanics.mjcf import own_text
from edmsim.plant.plant import MECHANICS
from edmsim.plant.resolution import resolution as check_resolution
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.heights import Area, Height, Heights
from edmsim.program.path import CutPath, plan_path
from edmsim.recording.closeups import Closeups
from edmsim.recording.frames import Frames
from edmsim.recording.report import build_report
from edmsim.recording.scene import Scene

if TYPE_CHECKING:
    import pyarrow as pa
    from shapely.geometry import MultiPolygon

CHECKPOINT_EVERY_S = 60.0
"""Wall time between checkpoints of a long cut."""
DRIVES = ("stepper",)
"""Axis drives."""


@dataclass(frozen=True)
class CutResult:
    """What a cut leaves.

    Attributes
    ----------
    report : dict
        The fields of ``report.json``.
    windows : pyarrow.Table
        A row per window of 255 pulses: ``windows.parquet``.
    path : CutPath
        The wire's path.
    field : KerfField
        The metal that is left.
    frames : Frames
        The wire's shape, thinned.
    scene : Scene
        The drawing: nominal and cut edges, errors, corners.
    closeups : Closeups
        Windows kept pulse by pulse: thinned, and all of them around events.
    machine : Machine
        The set-up.
    """

    report: dict[str, Any]
    windows: pa.Table
    path: CutPath
    field: KerfField
    frames: Frames
    scene: Scene
    closeups: Closeups
    machine: Machine

    def contour(self, slice_index: int) -> MultiPolygon:
        """Metal removed from one slice (0 is the bottom) as shapely polygons in mm; holes are what stays."""
        return contour(self.field, slice_index)

    def write(self, folder: str | Path) -> None:
        """Write ``report.json`` and ``.html``, ``windows.parquet``, ``profile.png``, ``part.npz`` and ``cut.rrd``."""
        from edmsim.recording import (
            profile_figure,
            write_figure,
            write_html,
            write_json,
            write_recording,
            write_scene,
            write_windows,
        )

        target = Path(folder)
        make_writable(target)
        title = Path(self.path.source).name
        write_windows(self.windows, target / "windows.parquet")
        write_figure(profile_figure(self.scene, self.windows, self.report, title), target / "profile.png")
        write_scene(self.scene, target / "part.npz")
        write_html(self.report, self.windows, self.scene, title, target / "report.html")
        write_recording(
            target / "cut.rrd", self.scene, self.windows, self.frames, self.closeups, self.machine, self.report, title
        )
        write_json(self.report, target / "report.json")


def cut(
    program: str | Path,
    *,
    out: str | Path | None = None,
    machine: str = "agiecut-dem15",
    material: str = "tool-steel",
    height_mm: float = 20.0,
    heights: Sequence[Height] | None = None,
    height_areas: Sequence[Area] | None = None,
    wire: str = "brass",
    tension: float | None = None,
    generator: str = "iso-pulse",
    t_on_us: float | None = None,
    t_period_us: float | None = None,
    controller: str | FeedController = "counts",
    drive: str = "stepper",
    planner: str = "poscal",
    mechanics: str = "modal",
    resolution: str = "default",
    offset: str | float = "auto",
    seed: int = 0,
    max_time_s: float | None = None,
    resume: bool = False,
    watch: Callable[[Progress], None] | None = None,
) -> CutResult:
    """Simulate a part program.

    Parameters
    ----------
    program : path
        G-code (.ngc .nc .gcode .iso) or DXF.
    out : path, optional
        Folder for the outputs; without one nothing is written.
    machine, material, wire, generator : str
        Names under `models/` or paths of own TOML files; a wire may carry a diameter in um ("brass-200").
    height_mm : float
        Workpiece height, where nothing else is said.
    heights : sequence of (from_mm, height_mm), optional
        From that length of wire path on (lead-in included) the workpiece has that height.
    height_areas : sequence of (polygon, height_mm), optional
        Inside a polygon (of shapely, or its corners) in mm of the program the workpiece has that height,
        whatever `heights` says; the first of overlapping ones holds.
    tension : float, optional
        Wire tension in newton.
    t_on_us, t_period_us : float, optional
        Setting of the pulse generator.
    controller : str or FeedController
        Feed controller, with parameters if wanted: ``"fixed:feed_um_s=20"``; a class in an own file,
        ``"own.py:Own"`` (see `edmsim.controllers.from_text`); or an object that is one.
    drive : str
        Axis drive; see `DRIVES`.
    mechanics : {"modal", "mujoco"}
        Integrator of table and wire (see `Plant`).
    planner : {"poscal", "poscal-literal", "dda", "sine-table"}
        What makes motor steps of path and speed; ``docs/planners.md`` has their errors.
    resolution : {"fast", "default", "fine"}
    offset : "auto", "none" or float
        Wire offset in mm; auto is the wire's radius and the expected side gap.
    seed : int
        Same seed, same cut.
    max_time_s : float, optional
        Machine time after which to stop.
    resume : bool
        Take up the interrupted cut of `out`.
    watch : callable, optional
        Called with a `Progress` after every window.

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
    _check_choice("mechanics", mechanics, MECHANICS)
    _check_choice("drive", drive, DRIVES)
    check_resolution(resolution)
    if max_time_s is not None and not 0 < max_time_s < math.inf:
        raise InputError(f"the time limit of {max_time_s:g} s must be finite and above zero")
    workpiece = Heights.of(height_mm, heights or (), height_areas or ())
    set_up = Machine.load(
        machine, material=material, wire=wire, generator=generator, height_mm=workpiece.greatest_mm, tension=tension,
        t_on_us=t_on_us, t_period_us=t_period_us,
    )
    law = make_controller(controller)
    travel_um = round(set_up.base.table.travel_mm.value * 1e3)
    unit = unit_for(travel_um)
    path = plan_path(
        program, offset, auto_offset_mm=set_up.auto_offset_mm, table_um=travel_um, grid_um=UNIT_UM[unit]
    )
    simulation = Simulation(
        set_up, path, law, planner=planner, seed=seed, resolution=resolution, max_time_s=max_time_s,
        steps=workpiece.steps(path, set_up.wire_diameter_um), mechanics=mechanics,
    )
    settings = {
        "program": Path(program).name, "program_sha256": _digest(Path(program).read_bytes()), "machine": machine,
        "material": material, "height_mm": workpiece.height_mm, **workpiece.settings(), "wire": wire,
        "wire_diameter_um": set_up.wire_diameter_um, "tension_N": set_up.tension, "generator": generator,
        "t_on_us": set_up.t_on_us, "t_period_us": set_up.t_period_us, **_told(controller),
        "drive": drive, "planner": planner, "position_unit": unit, "mechanics": mechanics, "resolution": resolution,
        "offset_um": path.offset_um, "max_time_s": max_time_s,
        "constants_sha256": _digest((set_up.model_dump_json() + own_text(set_up.base.model)).encode()),
    }
    folder = None if out is None else Path(out)
    spent_s = _run(simulation, folder, {**settings, "seed": seed}, resume, watch)
    notices = [*path.notices, *workpiece.notices(simulation.plant.resolution.slices)]
    if simulation.refused is not None:
        notices.append(f"the generator refused a setting the controller wanted: {simulation.refused}")
    if simulation.missed_windows:
        notices.append(
            f"the counts of {simulation.missed_windows} windows were missed: the controller's routine takes longer "
            "than a window; a longer period leaves it time"
        )
    result = _result(simulation, settings, notices, seed, spent_s)
    if folder is not None:
        result.write(folder)
        (folder / checkpoint.NAME).unlink(missing_ok=True)
    return result


def _run(
    simulation: Simulation, folder: Path | None, settings: dict[str, Any], resume: bool,
    watch: Callable[[Progress], None] | None,
) -> float:
    """Run to the end with checkpoints; returns the wall time spent."""
    before_s = 0.0
    if resume:
        if folder is None:
            raise InputError("to resume a cut, name its folder")
        before_s = checkpoint.load(simulation, folder, settings)
    if folder is not None:
        make_writable(folder)
    started = saved = time.monotonic()

    def turn(progress: Progress) -> None:
        nonlocal saved
        if watch is not None:
            watch(progress)
        now = time.monotonic()
        if folder is not None and now - saved > CHECKPOINT_EVERY_S and simulation.outcome is None:
            checkpoint.save(simulation, folder, settings, before_s + now - started)
            saved = now

    try:
        simulation.run(turn)
    except KeyboardInterrupt:
        if folder is not None:
            checkpoint.save(simulation, folder, settings, before_s + time.monotonic() - started)
        raise
    return before_s + time.monotonic() - started


def _result(
    simulation: Simulation, settings: dict[str, Any], notices: Sequence[str], seed: int, wall_time_s: float
) -> CutResult:
    found = inspect(simulation)
    windows = simulation.windows.to_arrow(found.error_um)
    assert simulation.outcome is not None
    report = build_report(
        outcome=simulation.outcome,
        reason=simulation.reason,
        windows=windows,
        totals=totals(simulation, wall_time_s),
        quality=found.quality,
        notices=notices,
        seed=seed,
        settings=settings,
        version=__version__,
    )
    return CutResult(
        report, windows, simulation.path, simulation.plant.field, simulation.frames, found.scene, simulation.closeups,
        simulation.machine,
    )


def make_controller(given: str | FeedController) -> FeedController:
    """Make a feed controller that a machine could have, or take one; see `edmsim.controllers.from_text`."""
    controller = from_text(given) if isinstance(given, str) else check_is_controller(given)
    if isinstance(controller, SeesTruth):
        raise InputError(
            f"the {controller.name} controller looks at the true gap, which no machine shows: it can be compared "
            "with (edmsim evaluate), not cut with"
        )
    return controller


def _told(controller: str | FeedController) -> dict[str, str]:
    """Return what the report's settings say of the controller; a file's text is part of what a cut was made with."""
    if not isinstance(controller, str):
        return {"controller": text_of(controller)}
    own = user_code.named(controller)
    digest = {} if own is None else {"controller_sha256": user_code.digest(own.file)}
    return {"controller": controller, **digest}


def _check_choice(what: str, name: str, choices: tuple[str, ...]) -> None:
    if name not in choices:
        raise InputError(f"unknown {what} '{name}'; there are: {', '.join(choices)}")


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
