"""``edmsim cut``."""

from __future__ import annotations

import shlex
import signal
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import INTERRUPTED, OUT, STOPPED, Program, Quiet, default_folder, say
from edmsim.cli.options import Unset, takes
from edmsim.errors import InputError


@takes(out=Unset("Default out/PROGRAM."))
def cut(
    program: Program,
    traces: Annotated[
        Path | None, typer.Option(help="File for samples of gap voltage and current, .parquet.")
    ] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Cut a part program."""
    from edmsim.cosim.stops import WORDS, StopCause
    from edmsim.files import make_writable
    from edmsim.job.checkpoint import NAME
    from edmsim.job.cut import CutProgress
    from edmsim.job.cut import cut as run_cut
    from edmsim.progress import ShownProgress

    folder = Path(options.pop("out", default_folder(program)))
    if traces is not None:
        if traces.suffix != ".parquet":
            raise InputError("the file for traces must end in .parquet", traces)
        make_writable(traces.parent)
    result = None
    try:
        with ShownProgress(quiet, keep=True) as bar, warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: say(str(message))
            shown = CutProgress(bar, program.name)
            result = run_cut(program, out=folder, **options, watch=shown.show, enter=shown.enter)
    except KeyboardInterrupt as interrupt:
        if result is None:
            has_checkpoint = (folder / NAME).exists()
            resumable = "interrupted; run the same command with --resume to continue"
            say(resumable if has_checkpoint else "interrupted before the cut began")
            number = next(iter(interrupt.args), signal.SIGINT)
            raise typer.Exit(128 + number) from None  # as shells have it
    if traces is not None:
        try:
            result.write_traces(traces)
        except KeyboardInterrupt:
            say(f"interrupted: the results are in {folder}, the traces are not written")
            raise typer.Exit(INTERRUPTED) from None
    with suppress(KeyboardInterrupt):  # all is written
        if not quiet:
            from edmsim.recording.report import render_table

            OUT.print(render_table(result.report))
            where = f"Written to {folder}; play it back with: edmsim view {shlex.quote(str(folder))}"
            OUT.print(where, highlight=False, soft_wrap=True, markup=False)
    if result.report.outcome != WORDS[StopCause.FINISHED].report:
        raise typer.Exit(STOPPED)
