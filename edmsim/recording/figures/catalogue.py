"""All figures of one cut, with their captions: what ``report.html`` holds and ``edmsim report`` writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from edmsim.cosim.pulse_sample import PulseSample
from edmsim.recording.figures.cut import corner_figure, error_figure, kerf_figure
from edmsim.recording.figures.pulses import delay_figure, plane_figure, pulses_figure
from edmsim.recording.figures.shares import shares_figure
from edmsim.recording.figures.wire import spectrum_figure
from edmsim.recording.scene import Scene

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure


class Picture(NamedTuple):
    """One figure of a cut: its name, fit for a file, what it shows, and the figure itself."""

    name: str
    caption: str
    figure: Figure


def pictures(
    report: Mapping[str, Any], windows: pa.Table, scene: Scene, sample: PulseSample | str,
    leave_out: Callable[[str], None],
) -> Iterator[Picture]:
    """Draw the figures of a cut, one after the other.

    Parameters
    ----------
    report : mapping
        As ``report.json`` holds it.
    windows : pyarrow.Table
        As ``windows.parquet`` holds it.
    scene : Scene
        As ``part.npz`` holds it.
    sample : PulseSample or str
        Single pulses of a straight cut with this cut's set-up, or why there are none
        (`edmsim.job.single_pulses.sample_or_reason`).
    leave_out : callable
        Called with which figures cannot be made of this cut, and why.

    Yields
    ------
    Picture
    """
    yield Picture("profile-error", "Profile error along the nominal edge.", error_figure(scene))
    yield Picture(
        "error-shares", "The profile error, and what path, planner, drive, wire and gap have of it, along the edge.",
        shares_figure(scene),
    )  # fmt: skip
    if scene.corners:
        yield Picture(
            "corner", "The corner with the largest error: paths and metal to scale, deviations below.",
            corner_figure(scene, windows),
        )  # fmt: skip
    yield Picture("kerf-section", "Cross-section of the kerf over the workpiece's height.", kerf_figure(report))
    yield Picture(
        "pulses", "What became of the pulses, and the share of the wire's front under gas, over machine time.",
        pulses_figure(windows),
    )  # fmt: skip
    yield Picture("short-open", "Short and open pulses, and the controller's path among them.", plane_figure(windows))
    if isinstance(sample, str):
        leave_out(f"ignition delays and the wire's spectrum are not drawn: {sample}")
        return
    yield from _of_single_pulses(sample, windows, report["settings"]["resolution"])


def _of_single_pulses(sample: PulseSample, windows: pa.Table, resolution: str) -> Iterator[Picture]:
    made = f"single pulses of a straight cut of the same set-up, simulated at {sample.feed_um_s:.1f} µm/s"
    yield Picture("ignition-delay", f"Ignition delays: {made}.", delay_figure(sample, windows))
    yield Picture(
        "wire-spectrum", f"Wire vibration: frequencies of its modes over tension, and the spectrum of {made}.",
        spectrum_figure([sample], resolution),
    )  # fmt: skip
