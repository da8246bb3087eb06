"""All figures of one cut, with their captions: what ``report.html`` holds and ``edmsim report`` writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from edmsim.cosim.pulse_sample import PulseSample
from edmsim.recording.figures.cut import corner_figure, error_figure, kerf_figure, shares_figure
from edmsim.recording.figures.passes import face_figure, passes_figure
from edmsim.recording.figures.pulses import delay_figure, plane_figure, pulses_figure
from edmsim.recording.figures.wire import spectrum_figure
from edmsim.recording.report import Report
from edmsim.recording.scene import Scene

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure


class Picture(NamedTuple):
    """One figure of a cut: its name, fit for a file, what it shows, and the figure itself."""

    name: str
    caption: str
    figure: Figure


OF_CUT: dict[str, Callable[[Report, pa.Table, Scene], Figure]] = {
    "profile-error": lambda report, windows, scene: error_figure(scene),
    "error-shares": lambda report, windows, scene: shares_figure(scene),
    "corner": lambda report, windows, scene: corner_figure(scene, windows),
    "kerf-section": lambda report, windows, scene: kerf_figure(report),
    "face": lambda report, windows, scene: face_figure(scene),
    "passes": lambda report, windows, scene: passes_figure(report),
    "pulses": lambda report, windows, scene: pulses_figure(windows),
    "short-open": lambda report, windows, scene: plane_figure(windows),
}
"""Figures of a cut by name: functions of report, windows and scene."""
OF_SAMPLE: dict[str, Callable[[PulseSample, pa.Table, Report], Figure]] = {
    "ignition-delay": lambda sample, windows, report: delay_figure(sample, windows),
    "wire-spectrum": lambda sample, windows, report: spectrum_figure([sample], report.settings["resolution"]),
}
"""Figures of single pulses by name: functions of the sample, windows and report."""
_CAPTIONS = {
    "profile-error": "Profile error along the nominal edge.",
    "error-shares":
        "The profile error, and what path, planner, drive, wire and gap have of it, along the edge.",
    "corner": "The corner with the largest error: paths and metal to scale, deviations below.",
    "kerf-section": "Cross-section of the kerf over the workpiece's height.",
    "face": "The cut face unrolled: profile error over path and height.",
    "passes": "Passes: the wall each left over the height, time, metal left and roughness.",
    "pulses": "What became of the pulses, and the share of the wire's front under gas, over machine time.",
    "short-open": "Short and open pulses, and the controller's path among them.",
    "ignition-delay": "Ignition delays: {made}.",
    "wire-spectrum": "Wire vibration: frequencies of its modes over tension, and the spectrum of {made}.",
}


def pictures(
    report: Report, windows: pa.Table, scene: Scene, sample: PulseSample | str, leave_out: Callable[[str], None]
) -> Iterator[Picture]:
    """Draw the figures of a cut one by one; `leave_out` is called with those that cannot be made, and why."""
    for name, draw in OF_CUT.items():
        if (name != "corner" or scene.corners) and (name != "passes" or report.passes):
            yield Picture(name, _CAPTIONS[name], draw(report, windows, scene))
    if isinstance(sample, str):
        leave_out(f"ignition delays and the wire's spectrum are not drawn: {sample}")
        return
    made = f"single pulses of a straight cut of the same set-up, simulated at {sample.feed_um_s:.1f} µm/s"
    for name, draw_sample in OF_SAMPLE.items():
        yield Picture(name, _CAPTIONS[name].format(made=made), draw_sample(sample, windows, report))
