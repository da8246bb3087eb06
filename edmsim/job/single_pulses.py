"""Single pulses of a straight cut like a cut that was made, for its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from edmsim.cosim.pulse_sample import PULSES, PulseSample, cutting_feed_um_s, sample_pulses
from edmsim.errors import EdmsimError, InputError
from edmsim.job.settings import CutSettings

if TYPE_CHECKING:
    import pyarrow as pa


def sample_like(report: Mapping[str, Any], windows: pa.Table, *, pulses: int = PULSES) -> PulseSample:
    """Look at single pulses of a straight cut with a cut's set-up, seed and resolution, at its median feed.

    The workpiece has its greatest height, and modes move the wire, whatever moved it in the cut.

    Parameters
    ----------
    report : mapping
        The cut's report, as ``report.json`` holds it.
    windows : pyarrow.Table
        The cut's table of windows.
    pulses : int
        How many to look at.

    Raises
    ------
    InputError
        If the cut never cut, its set-up cannot be read any more, or as `sample_pulses`.
    """
    feed = cutting_feed_um_s(windows)
    if feed is None:
        raise InputError("the cut has no window with metal near the wire")
    settings = CutSettings.of_report(report)
    return sample_pulses(
        settings.load_machine(), feed, seed=settings.seed, pulses=pulses, resolution=settings.resolution
    )


def sample_or_reason(report: Mapping[str, Any], windows: pa.Table) -> PulseSample | str:
    """Return what `sample_like` does, or why it cannot."""
    try:
        return sample_like(report, windows)
    except EdmsimError as error:
        return str(error)
