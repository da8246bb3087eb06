"""``edmsim find-guides``."""

from __future__ import annotations

import sys
from typing import Any

from edmsim.cli.console import ERR, OUT, Json, Quiet
from edmsim.cli.options import takes


@takes(
    "machine", "height_mm", "wire", "constants", "taper_deg", "guide_errors_mm", "resolution", "seed",
    resolution="fast", taper_deg=10.0,
)  # fmt: skip
def find_guides(json: Json = False, quiet: Quiet = False, **options: Any) -> None:
    """Find the heights of the wire guides from a test cut."""
    from json import dumps

    from edmsim.cli.progress import ProgressBar
    from edmsim.job.settings import CutSettings
    from edmsim.measure.guides import measure_guides as measure

    settings = CutSettings.model_validate(options)
    watcher = ProgressBar(quiet, ERR)
    with watcher:
        watcher.enter("cutting")
        found = measure(
            settings.load_machine(), settings.taper_deg, settings.guide_errors_mm or (0.0, 0.0), seed=settings.seed,
            resolution=settings.resolution, watch=watcher.show,
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
