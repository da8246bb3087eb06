"""What a cut leaves behind: the table of windows, the wire's frames, report, figure and rerun recording."""

from edmsim.recording.figures import profile_figure, write_figure
from edmsim.recording.film import render
from edmsim.recording.html_report import write_html
from edmsim.recording.report import Report, Totals, build_report, render_table, write_json
from edmsim.recording.rerun.playback import Playback, find_recording
from edmsim.recording.rerun.viewer import compare, take_screenshots, view
from edmsim.recording.rerun.write import write_recording
from edmsim.recording.scene import ErrorMap, Scene, SceneCorner, Terrace, polylines, read_scene, write_scene
from edmsim.recording.stores import Closeups, Frames
from edmsim.recording.windows import WindowTable, read_windows, write_windows

__all__ = [
    "Closeups", "ErrorMap", "Frames", "Playback", "Report", "Scene", "SceneCorner", "Terrace", "Totals",
    "WindowTable", "build_report", "compare", "find_recording", "polylines", "profile_figure", "read_scene",
    "read_windows", "render", "render_table", "take_screenshots", "view", "write_figure", "write_html", "write_json",
    "write_recording", "write_scene", "write_windows",
]
