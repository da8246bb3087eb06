"""``edmsim calibrate`` and ``validate``: the model beside machines and publications."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import INTERRUPTED, OUT, Json, named, say
from edmsim.cli.options import SET_UP, Unset, takes
from edmsim.errors import FAILED

_BY_LOG = Unset("Default: as in the log.")


@takes(
    "machine", SET_UP, "resolution", "seed",
    **dict.fromkeys(("machine", "material", "wire", "generator", "height_mm"), _BY_LOG),
    resolution=Unset("Default: as in the log, or fast."),
)
def calibrate(
    log: Annotated[Path, typer.Argument(help="Table of windows, .parquet or CSV.", show_default=False)],
    out: Annotated[Path, typer.Option(help="TOML file for the machine; material and wire go to the same folder.")],
    fit: Annotated[
        str | None, typer.Option(metavar="A,B", help="Constants or sections to fit; default: the usual three.")
    ] = None,
    json: Json = False,
    **options: Any,
) -> None:
    """Fit the model's constants to a machine's log."""
    from edmsim.calibration import DEFAULT_CONSTANTS, read_log, settings_for
    from edmsim.calibration import calibrate as run
    from edmsim.calibration.comparison import CalibrationProgress
    from edmsim.calibration.output import as_json, check_writable, render, write
    from edmsim.calibration.set_up import held, machine_of
    from edmsim.progress import ShownProgress
    from edmsim.runs import RunTable

    check_writable(out)
    table = read_log(log)
    seed = options.pop("seed")
    settings, notices = settings_for(table, **options)
    chosen = DEFAULT_CONSTANTS if fit is None else named(fit)
    runs = out.with_suffix(".runs.jsonl")
    set_up = machine_of(settings)
    for notice in (*notices, *held(settings, set_up, chosen)):
        say(notice)
    try:
        with ShownProgress() as bar:

            def watch(progress: CalibrationProgress) -> None:
                misfit = "" if math.isnan(progress.misfit) else f", misfit {progress.misfit:.2f}"
                bar.show("calibrate", text=f"{progress.cuts} cuts simulated{misfit}")

            found = run(table, set_up, chosen, seed=seed, resolution=settings.resolution, table=RunTable(runs),
                        watch=watch)  # fmt: skip
    except KeyboardInterrupt:
        say("interrupted; run the same command to resume")
        raise typer.Exit(INTERRUPTED) from None
    files = write(found, table.name, out, [name for name, _ in settings.overrides])
    runs.unlink(missing_ok=True)
    if json:
        sys.stdout.write(as_json(found, files) + "\n")
        return
    OUT.print(render(found, settings.resolution))
    fitted = " ".join(f"--{part} {file}" for part, file in files.items())
    OUT.print(f"Cut with it: edmsim cut PROGRAM {fitted} --out DIR", highlight=False, soft_wrap=True, markup=False)


def validate(
    failed: Annotated[bool, typer.Option("--failed", help="Show only rows that fail, with the reasons.")] = False,
    json: Json = False,
) -> None:
    """Compare the model with publications, row by row."""
    from edmsim.progress import ShownProgress
    from edmsim.validation import report, run

    with ShownProgress() as bar:
        rows = run(bar.of("validate"))
    if json:
        sys.stdout.write(report.as_json(rows, report.failed(rows) if failed else None) + "\n")
    else:
        OUT.print(report.render_failed(rows) if failed else report.render(rows))
    if any(row.unexpected for row in rows):
        raise typer.Exit(FAILED)
