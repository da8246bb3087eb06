"""The figures of a cut: ``profile.png``, and the ones for a paper, one function each.

Each takes what a cut leaves and returns a matplotlib figure with an Agg canvas; ``figure.savefig("name.pdf")`` writes
it. No global state of matplotlib is touched, and no display is needed.
"""

from edmsim.recording.figures.cut import corner_figure, error_figure, kerf_figure, shares_figure
from edmsim.recording.figures.passes import face_figure, passes_figure
from edmsim.recording.figures.profile import profile_figure, write_figure
from edmsim.recording.figures.pulses import delay_figure, plane_figure, pulses_figure
from edmsim.recording.figures.wire import spectrum_figure

__all__ = [
    "corner_figure", "delay_figure", "error_figure", "face_figure", "kerf_figure", "passes_figure", "plane_figure",
    "profile_figure", "pulses_figure", "shares_figure", "spectrum_figure", "write_figure",
]
