"""A cut's folder read back: report, windows and drawing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import folder_of
from edmsim.recording.report import Report, cut_id, outcome_text
from edmsim.recording.scene import Scene, read_scene
from edmsim.recording.windows import CUT_KEY, read_windows

if TYPE_CHECKING:
    import pyarrow as pa

RECORDING = "cut.rrd"  # name of the recording for rerun


class RecordedCut(NamedTuple):
    """Contents of a cut's folder: ``report.json``, ``windows.parquet``, ``part.npz``."""

    report: Report
    windows: pa.Table
    scene: Scene

    def __repr__(self) -> str:
        """Say which cut it is and how it ended: report and windows fill pages."""
        return f"<RecordedCut of {self.title}: {outcome_text(self.report)}, {self.windows.num_rows} windows>"

    @property
    def title(self) -> str:
        """The program's name."""
        return str(self.report.settings["program"])


@refuses_wrong_types
def read_cut(directory: str | Path) -> RecordedCut:
    """Read a folder that ``edmsim cut`` has written.

    Raises
    ------
    InputError
        If a file is missing, damaged, or of another version, or the cuts differ.
    """
    folder = folder_of(directory)
    cut = RecordedCut(
        _read_report(folder / "report.json"), read_windows(folder / "windows.parquet"),
        read_scene(folder / "part.npz"),
    )  # fmt: skip
    in_windows = (cut.windows.schema.metadata or {}).get(CUT_KEY)
    whose = None if in_windows is None else in_windows.decode("ascii", "replace")
    if (whose or cut.scene.cut) and {whose, cut.scene.cut} != {cut_id(cut.report)}:
        raise InputError("report.json, windows.parquet and part.npz in it are not of one cut: cut again", folder)
    return cut


def _read_report(file: Path) -> Report:
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(report, dict) or "settings" not in report:
            raise ValueError("no settings in it")
        if missing := [name for name in Report() if name not in report]:
            made_by = report.get("edmsim_version")
            raise InputError(f"written by edmsim {made_by} without {missing[0]}: cut again", file)
        return Report(**report)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("no such file, the folder of a cut is needed", file) from None
    except (OSError, ValueError, TypeError, RecursionError) as error:  # brackets within brackets, too
        raise InputError(f"not the report of a cut ({error})", file) from None
