"""``edmsim export``: the gap for other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import OUT
from edmsim.cli.options import SET_UP, takes
from edmsim.errors import InputError


@takes("machine", SET_UP, "resolution", resolution="fast")
def export(
    kind: Annotated[str, typer.Argument(help="What to write: fmu (FMI 3.0, co-simulation).", show_default=False)],
    out: Annotated[Path, typer.Option(help="File, .fmu.")],
    gap: Annotated[float, typer.Option(help="Gap round the wire at the start in um.")] = 30.0,
    **options: Any,
) -> None:
    """Write the gap for another simulator."""
    from edmsim.hil.fmu import export_fmu
    from edmsim.job.settings import CutSettings

    if kind != "fmu":
        raise InputError(f"there is no export '{kind}': choose fmu")
    settings = CutSettings.model_validate(options)
    step_s = export_fmu(out, resolution=settings.resolution, gap_um=gap, name=settings.machine, **settings.set_up)
    OUT.print(f"Written: {out}; its step is {step_s:.9g} s", highlight=False, soft_wrap=True, markup=False)
