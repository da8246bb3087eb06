"""``edmsim find-guides``."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from edmsim.cli.console import ERR, OUT, GuideErrors, Height, Machine, Resolution, Seed, Wire, parse_guide_errors


def find_guides(
    machine: Machine = "agiecut-dem15",
    height: Height = 20.0,
    wire: Wire = "brass",
    constant: Annotated[
        list[str] | None, typer.Option(metavar="NAME=NUMBER", help="A constant's value; may be given again.")
    ] = None,
    taper_deg: Annotated[float, typer.Option(help="Angle in degrees by which the block's walls lean.")] = 10.0,
    guide_errors: GuideErrors = None,
    resolution: Resolution = "fast",
    seed: Seed = 0,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Find the heights of the wire guides from a test cut."""
    from json import dumps

    from edmsim.cli.progress import ProgressBar
    from edmsim.job.settings import CutSettings
    from edmsim.machine.overrides import parse_constant
    from edmsim.measure.guides import measure_guides as measure

    settings = CutSettings.model_validate({
        "machine": machine, "height_mm": height, "wire": wire, "constants": dict(map(parse_constant, constant or ())),
        "guide_errors_mm": parse_guide_errors(guide_errors), "resolution": resolution, "seed": seed,
    })  # fmt: skip
    watcher = ProgressBar(quiet, ERR)
    with watcher:
        watcher.enter("cutting")
        found = measure(
            settings.load_machine(), taper_deg, settings.guide_errors_mm or (0.0, 0.0), seed=settings.seed,
            resolution=resolution, watch=watcher.show,
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
