"""``edmsim measure``: a machine's table, and the heights of its wire guides."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import OUT, Json, Quiet
from edmsim.cli.options import Unset, takes


@takes(
    "machine", "compensation", "seed",
    compensation=Unset("What is written is then what these tables, in force, have left."),
)
def table(
    out: Annotated[Path | None, typer.Option(help="File for the compensation tables, .toml.")] = None,
    interval: Annotated[float | None, typer.Option(help="Distance between targets in mm; default: 0.5.")] = None,
    runs: Annotated[int | None, typer.Option(help="Runs to every target in each direction; default: 5.")] = None,
    cubic: Annotated[bool, typer.Option("--cubic", help="Interpolate the tables by curves.")] = False,
    plot: Annotated[Path | None, typer.Option(help="File for the figure, .png .svg or .pdf.")] = None,
    json: Json = False,
    **options: Any,
) -> None:
    """Measure a machine's table as a laser interferometer does."""
    from edmsim.controllers.axis.elcam.file import load_tables, read_tables, text_of
    from edmsim.errors import InputError
    from edmsim.files import make_writable, replacing
    from edmsim.job.result import FORMATS
    from edmsim.job.settings import CutSettings
    from edmsim.measure import as_json, headline, measure_table, render

    if plot is not None and plot.suffix.removeprefix(".") not in FORMATS:
        raise InputError(f"a figure is written as one of {', '.join(FORMATS)}", plot)
    settings = CutSettings.model_validate(options)
    compensation = settings.compensation
    loaded = None if compensation is None else load_tables(read_tables(compensation), compensation)
    worn = settings.load_machine()
    for file in (out, plot):
        if file is not None:
            make_writable(file.parent)
    found = measure_table(worn, interval_mm=interval, runs=runs, seed=settings.seed, compensation=loaded)
    if out is not None:
        about = f"Errors of the table of {settings.machine}: what an axis indicates less where it truly is."
        with replacing(out) as partial:
            partial.write_text(text_of(found.tables(cubic), [about, *headline(found)]), encoding="utf-8")
    if plot is not None:
        from edmsim.measure import table_figure

        with replacing(plot) as partial:
            table_figure({"measured": found}).savefig(partial, format=plot.suffix.removeprefix("."))
    if json:
        sys.stdout.write(as_json(found) + "\n")
        return
    OUT.print(render(found))
    if out is not None:
        OUT.print(f"Cut with it: edmsim cut PROGRAM --compensation {out} --out DIR", highlight=False, soft_wrap=True)


@takes(
    "machine", "height_mm", "wire", "constants", "taper_deg", "guide_errors_mm", "resolution", "seed",
    resolution="fast", taper_deg=10.0,
)  # fmt: skip
def guides(json: Json = False, quiet: Quiet = False, **options: Any) -> None:
    """Measure the heights of the wire guides by a test cut."""
    from json import dumps

    from edmsim.job.cut import CutProgress
    from edmsim.job.settings import CutSettings
    from edmsim.measure import measure_guides
    from edmsim.progress import ShownProgress

    settings = CutSettings.model_validate(options)
    with ShownProgress(quiet) as bar:
        found = measure_guides(
            settings.load_machine(), settings.taper_deg, settings.guide_errors_mm or (0.0, 0.0), seed=settings.seed,
            resolution=settings.resolution, watch=CutProgress(bar, "test cut").show,
        )
    lower_um, upper_um = found.uncertainty_mm
    if json:
        sys.stdout.write(dumps({
            "lower_mm": found.lower_mm, "upper_mm": found.upper_mm, "uncertainty_mm": found.uncertainty_mm,
            "heights_mm": found.heights_mm.tolist(), "shift_um": found.shift_um.tolist(),
        }) + "\n")  # fmt: skip
        return
    for name, error, own in (("lower", found.lower_mm, lower_um), ("upper", found.upper_mm, upper_um)):
        OUT.print(f"the {name} guide is {error:+.3f} mm higher than its file says, ±{own:.3f} mm", highlight=False)
    message = f"Cut with it: edmsim cut PROGRAM --guide-errors={found.lower_mm:.3f}:{found.upper_mm:.3f}"
    OUT.print(message, highlight=False, soft_wrap=True)
