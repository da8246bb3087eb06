"""Results of a cut: its recordings, report, tables, drawing and remaining metal, and their files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import shapely

from edmsim import __version__
from edmsim.cosim.simulation import Simulation
from edmsim.cosim.straight import PULSES, PulseSample, cutting_feed_um_s, sample_pulses
from edmsim.errors import EdmsimError, InputError, one_of, refuses_wrong_types
from edmsim.files import check_suffix, folder_of, locked, make_writable, together
from edmsim.job.inspection import inspect, totals
from edmsim.job.settings import METADATA_KEY, CutSettings
from edmsim.machine.machine import Machine, constants_digest
from edmsim.metrology.edges import contour, without_specks
from edmsim.numeric import real
from edmsim.plant.resolution import resolution as resolution_named
from edmsim.plant.workpiece.height_steps import LowerRegion, middle_slice
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.path import CutPath
from edmsim.recording.cut_folder import read_cut
from edmsim.recording.report import Report, build_report, cut_id, outcome_text, summary, write_json
from edmsim.recording.scene import Scene, write_scene
from edmsim.recording.windows import CUT_KEY, Closeups, Frames, WindowTable, write_traces, write_windows

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure
    from shapely.geometry import MultiPolygon


class Recorders(NamedTuple):
    """The observers of a cut."""

    windows: WindowTable  # a row per window
    frames: Frames  # the wire's shape, thinned
    closeups: Closeups  # windows kept pulse by pulse


def recorders_for(machine: Machine, steps: Sequence[LowerRegion], resolution: str) -> Recorders:
    """Return empty recorders for a cut of a workpiece with some height steps."""
    size = resolution_named(resolution)
    lowest_mm = min([step.height_mm for step in steps], default=machine.height_mm)
    middle = middle_slice(lowest_mm, machine.height_mm, size.slices)
    windows = WindowTable(machine.generator.equalising is not None)
    return Recorders(windows, Frames(size.slices), Closeups(size.slices, size.rays, middle))


@refuses_wrong_types
def sample_like(report: Report, windows: pa.Table, *, pulses: int = PULSES) -> PulseSample:
    """Sample pulses of a straight cut with a cut's set-up, seed and resolution, at its median feed.

    The workpiece has its greatest height, and the mechanics are always modal.
    """
    feed = cutting_feed_um_s(windows)
    if feed is None:
        raise InputError("the cut has no window with metal near the wire")
    settings = CutSettings.of_report(report)
    machine = settings.load_machine()
    if constants_digest(machine) != report.settings["constants_sha256"]:
        raise InputError("a file of the set-up has other constants than the cut had: undo the change, or cut again")
    return sample_pulses(machine, feed, seed=settings.seed, pulses=pulses, resolution=settings.resolution)


def sample_or_reason(report: Report, windows: pa.Table) -> PulseSample | str:
    """Return what `sample_like` does, or why it cannot."""
    try:
        return sample_like(report, windows)
    except EdmsimError as error:
        return str(error)


@dataclass(frozen=True, eq=False)
class CutResult:
    """Results of a cut."""

    report: Report  # the fields of ``report.json``
    windows: pa.Table  # a row per window of 255 pulses: ``windows.parquet``; its metadata have the `CutSettings`
    path: CutPath  # the wire's path
    field: KerfField  # the remaining metal
    frames: Frames  # the wire's shape in a subset of windows
    scene: Scene  # the drawing: nominal and cut edges, errors, corners
    closeups: Closeups  # windows with every pulse: a subset, and all of them around events
    machine: Machine  # the set-up

    def __repr__(self) -> str:
        """Say how it ended and the key figures: the fields of the report hold the rest."""
        shown = ("machining time", "path", "kerf", "profile error", "corners")
        lines = [f"  {name:14} {text}" for name, text in summary(self.report) if name in shown]
        return "\n".join([f"<CutResult of {self._title}: {outcome_text(self.report)}", *lines]) + ">"

    def _repr_html_(self) -> str:
        """Show table and picture in a notebook."""
        from edmsim.recording.html_report import card

        return card(self.report, self._title, self.plot())

    @property
    def _title(self) -> str:
        return str(self.report.settings["program"])

    @refuses_wrong_types
    def plot(self, figure: str = "profile") -> Figure:
        """Draw a figure of the cut; a notebook shows it if it is the last line of a cell.

        Parameters
        ----------
        figure : str
            ``"profile"``, the picture of ``profile.png``: part, error and process; or a figure of ``edmsim report``:
            ``"profile-error"``, ``"error-shares"``, ``"corner"``, ``"kerf-section"``, ``"face"``, ``"passes"``,
            ``"pulses"``, ``"short-open"``, ``"ignition-delay"``, ``"wire-spectrum"``. The last two simulate single
            pulses of a straight cut with the same set-up, which takes some seconds.

        Returns
        -------
        matplotlib.figure.Figure
            With an Agg canvas; ``plot().savefig("cut.pdf")`` writes it.

        Raises
        ------
        InputError
            If there is no such figure, or this cut has no single pulses.
        """
        from edmsim.recording.figures.profile import profile_figure
        from edmsim.recording.html_report import OF_CUT, OF_SAMPLE

        if figure in OF_SAMPLE:
            return OF_SAMPLE[figure](sample_like(self.report, self.windows), self.windows, self.report)
        if figure in OF_CUT:
            return OF_CUT[figure](self.report, self.windows, self.scene)
        if figure != "profile":
            known = ["profile", *OF_CUT, *OF_SAMPLE]
            raise InputError(f"there is no figure '{figure}'; there are: {one_of(figure, known)}")
        return profile_figure(self.scene, self.windows, self.report, self._title)

    @refuses_wrong_types
    def contour(
        self, slice_index: int | None = None, *, coordinates: Literal["program", "table"] = "program",
        specks: bool = False,
    ) -> MultiPolygon:
        """Return the metal removed from one slice as shapely polygons in mm; holes are remaining metal.

        Parameters
        ----------
        slice_index : int, optional
            0 is the bottom; by default the slice at mid height, for a stepped workpiece that of its lowest part.
        coordinates : {"program", "table"}
            Those of the program or drawing, or the table's, as in `windows`, `path` and `field`. They differ by
            ``path.origin_mm``.
        specks : bool
            Whether to keep single craters next to the kerf and crumbs of metal in it, smaller than a hundredth of
            the wire's cross-section.

        Raises
        ------
        InputError
            If there is no such slice, or there are no such coordinates.
        """
        if coordinates not in ("program", "table"):
            raise InputError(f"there are no coordinates '{coordinates}'; there are: program, table")
        removed = contour(self.field, self.scene.middle_slice() if slice_index is None else slice_index)
        if not specks:
            removed = without_specks(removed, self.scene.speck_mm2)
        if coordinates == "table":
            return removed
        return shapely.transform(removed, lambda mm: mm - self.path.origin_mm)

    @refuses_wrong_types
    def write_traces(
        self, file: str | Path, *, every_us: float = 0.5, begin_s: float = 0.0, end_s: float = math.inf
    ) -> None:
        """Write samples of gap voltage and current, as of an oscilloscope, to a Parquet file.

        The file has the last 96 pulses of some windows: a subset over the whole cut, and every window around retracts
        and corners (`closeups`). Each sample has the true class of its pulse, as a label for a discriminator.

        Parameters
        ----------
        file : path
            Columns ``window_t_s`` (s, the ``t_s`` of the row of `windows`), ``time_us`` (since that window's
            begin), ``voltage_V``, ``current_A``, ``pulse`` (number of the pulse in its window's excerpt) and
            ``kind`` (``open``, ``spark``, ``arc`` or ``short``).
        every_us : float
            Time between samples, 0.001 or more. Edges are vertical: the model has no rise times, lines or noise.
        begin_s, end_s : float
            Only windows that end within this span of machine time.

        Raises
        ------
        InputError
            If the time between samples is below 0.001 us, a limit of the span is not a number, or the file cannot be
            written.
        """
        for name, time_s in (("begin_s", begin_s), ("end_s", end_s)):
            if real(time_s) is None or math.isnan(time_s):
                raise InputError(f"{name} is {time_s!r}: give a machine time in s")
        check_suffix(Path(file), "a file of traces", ".parquet")
        make_writable(Path(file).parent)
        rows = self.closeups.table()
        write_traces(rows[(rows["t_s"] >= begin_s) & (rows["t_s"] <= end_s)], file, every_us)

    @refuses_wrong_types
    def write(self, folder: str | Path, enter: Callable[[str], None] | None = None) -> None:
        """Write ``report.json`` and ``.html``, ``windows.parquet``, ``profile.png``, ``part.npz`` and ``cut.rrd``.

        They replace those of an earlier cut together, when all are complete.

        Parameters
        ----------
        folder : path
        enter : callable, optional
            Called with the name of a phase when it begins: figures, recording.

        Raises
        ------
        InputError
            If the folder cannot be written to.
        OSError
            If writing fails later, for example on a full disk.
        """
        from edmsim.recording.figures.profile import profile_png
        from edmsim.recording.html_report import write_html
        from edmsim.recording.rerun.write import write_recording

        tell, title = enter or (lambda _: None), self._title
        with together(make_writable(folder), "report.json") as target:
            tell("figures")
            write_windows(self.windows, target / "windows.parquet")
            picture = profile_png(self.scene, self.windows, self.report, title)
            (target / "profile.png").write_bytes(picture)
            write_scene(self.scene, target / "part.npz")
            sample = sample_or_reason(self.report, self.windows)
            write_html(self.report, self.windows, self.scene, sample, title, picture, target / "report.html")
            tell("recording")
            write_recording(
                target / "cut.rrd", self.scene, self.windows, self.frames, self.closeups, self.machine, self.report,
                title,
            )
            write_json(self.report, target / "report.json")


def result_of(
    simulation: Simulation, recorders: Recorders, settings: CutSettings, made_with: Mapping[str, Any],
    notices: Sequence[str], wall_time_s: float,
) -> CutResult:
    """Measure a cut that is over."""
    found = inspect(simulation, recorders.windows)
    windows = recorders.windows.to_arrow(found.error_um)
    assert simulation.outcome is not None
    report = build_report(
        found.part, windows, totals(simulation, recorders.windows, wall_time_s), outcome=simulation.outcome,
        reason=simulation.reason, notices=notices, seed=settings.seed, settings=made_with, version=__version__,
    )
    whose, passes = cut_id(report), simulation.path.passes
    logged = settings if passes == 1 else settings.model_copy(update={"passes": passes})  # also those of the program
    return CutResult(
        report, windows.replace_schema_metadata({METADATA_KEY: logged.model_dump_json(), CUT_KEY: whose}),
        simulation.path, simulation.plant.field, recorders.frames, replace(found.scene, cut=whose),
        recorders.closeups, simulation.machine,
    )  # fmt: skip


def remake(
    directory: str | Path, figures: str | Path | None, kind: str, leave_out: Callable[[str], None]
) -> list[Path]:
    """Write a folder's ``report.html`` again, or its figures as files of their own; returns the files written."""
    from edmsim.recording.figures.profile import profile_png
    from edmsim.recording.figures.style import FORMATS, write_figure
    from edmsim.recording.html_report import pictures, write_html

    if kind not in FORMATS:
        raise InputError(f"figures cannot be written as '{kind}'; there are: {one_of(kind, FORMATS)}")
    cut = read_cut(directory)
    sample = sample_or_reason(cut.report, cut.windows)
    target = folder_of(directory if figures is None else figures)
    if figures is None:
        with locked(target):
            profile = profile_png(cut.scene, cut.windows, cut.report, cut.title)
            write_html(*cut, sample, cut.title, profile, target / "report.html")
        return [target / "report.html"]
    written = []
    for picture in pictures(*cut, sample, leave_out):
        written.append(target / f"{picture.name}.{kind}")
        write_figure(picture.figure, written[-1])
    return written
