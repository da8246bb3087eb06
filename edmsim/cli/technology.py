"""``edmsim technology``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import INTERRUPTED, OUT, Quiet, say
from edmsim.cli.options import takes


@takes(
    "height_mm", "wire", "machine", "resolution", "seed", wire="brass-254", machine="production", resolution="fast"
)
def technology(
    material: Annotated[str, typer.Argument(help="Workpiece material, a name or your own file.", show_default=False)],
    passes: Annotated[int, typer.Option(help="Number of passes, rough and trims: 1 to 7.")] = 4,
    out: Annotated[
        Path | None,
        typer.Option(help="TOML file; the height is added to an existing one. Default: MATERIAL-WIRE.toml."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Resume the interrupted search of that file.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Search for offsets and settings of passes by simulated cuts, and write a technology."""
    from edmsim.evaluation.technology import Job, Search, merged, technology_text
    from edmsim.files import make_writable, replacing
    from edmsim.machine.technology import read_technology

    job = Job(material, passes=passes, **options)
    file = Path(f"{Path(material).stem}-{Path(job.wire).stem}.toml") if out is None else out
    job.check()
    make_writable(file.parent)
    known = read_technology(str(file)) if file.exists() else None
    if known is not None:
        job.check_like(known, file)
    journal = file.with_suffix(".journal.json")
    try:
        found = Search(job, (lambda text: None) if quiet else _tell, journal).run(resume)
    except KeyboardInterrupt:
        say(f"interrupted; run the same command with --resume to continue after the passes in {journal}")
        raise typer.Exit(INTERRUPTED) from None
    source = f"found by simulation: edmsim technology {material} --height {job.height_mm:g} --passes {passes}"
    with replacing(file) as partial:
        partial.write_text(technology_text(job, merged(known, job, found), source), encoding="utf-8")
    journal.unlink(missing_ok=True)
    OUT.print(f"Written: {file}; cut with it: edmsim cut PROGRAM --passes {passes} --technology {file}",
              highlight=False, soft_wrap=True, markup=False)  # fmt: skip


def _tell(text: str) -> None:
    OUT.print(text, highlight=False, soft_wrap=True, markup=False)
