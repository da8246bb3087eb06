"""``edmsim export``: the gap for other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import OUT, Generator, Height, Machine, Material, Resolution, Tension, Wire
from edmsim.errors import InputError


def export(
    kind: Annotated[str, typer.Argument(help="What to write: fmu (FMI 3.0, co-simulation).", show_default=False)],
    out: Annotated[Path, typer.Option(help="File, .fmu.")],
    machine: Machine = "agiecut-dem15",
    material: Material = "tool-steel",
    height: Height = 20.0,
    wire: Wire = "brass",
    generator: Generator = "iso-pulse",
    tension: Tension = None,
    gap: Annotated[float, typer.Option(help="Gap round the wire at the start in um.")] = 30.0,
    resolution: Resolution = "fast",
) -> None:
    """Write the gap for another simulator."""
    from edmsim.hil.fmu import export_fmu

    if kind != "fmu":
        raise InputError(f"there is no export '{kind}': choose fmu")
    step_s = export_fmu(
        out, resolution=resolution, gap_um=gap, name=machine, material=material, height_mm=height, wire=wire,
        generator=generator, tension=tension,
    )  # fmt: skip
    OUT.print(f"Written: {out}; its step is {step_s:.9g} s", highlight=False, soft_wrap=True, markup=False)
