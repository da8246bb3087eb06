"""A cut's folder read back: report, windows and drawing, and the page and figures made of them anew."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.recording.figures.catalogue import pictures
from edmsim.recording.html_report import write_html
from edmsim.recording.scene import Scene
from edmsim.recording.scene_file import read_scene
from edmsim.recording.windows import read_windows

if TYPE_CHECKING:
    import pyarrow as pa

FORMATS = ("pdf", "svg", "png")
"""Kinds of files that figures are written as."""


class RecordedCut(NamedTuple):
    """What a cut left in its folder: ``report.json``, ``windows.parquet``, ``part.npz``."""

    report: dict[str, Any]
    windows: pa.Table
    scene: Scene

    @property
    def title(self) -> str:
        """The program's name."""
        return str(self.report["settings"]["program"])


def read_cut(directory: str | Path) -> RecordedCut:
    """Read a folder that ``edmsim cut`` has written.

    Raises
    ------
    InputError
        If a file is missing, damaged, or of another version.
    """
    folder = Path(directory)
    return RecordedCut(
        _read_report(folder / "report.json"), read_windows(folder / "windows.parquet"),
        read_scene(folder / "part.npz"),
    )  # fmt: skip


def _read_report(file: Path) -> dict[str, Any]:
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(report, dict) or "settings" not in report:
            raise ValueError("no settings in it")
    except FileNotFoundError:
        raise InputError("no such file, the folder of a cut is needed", file) from None
    except (OSError, ValueError) as error:
        raise InputError(f"not the report of a cut ({error})", file) from None
    if "kerf_section" not in report:
        raise InputError(f"written by edmsim {report.get('edmsim_version')} without kerf_section: cut anew", file)
    return report


def remake(
    directory: str | Path, figures: str | Path | None, kind: str, leave_out: Callable[[str], None]
) -> list[Path]:
    """Write a folder's ``report.html`` anew, or its figures as files of their own.

    Parameters
    ----------
    directory : path
        Folder of a cut.
    figures : path or None
        Folder for the figures; without one the page is written.
    kind : {"pdf", "svg", "png"}
        Of the figures' files.
    leave_out : callable
        Is told which figures cannot be made of this cut, and why.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InputError
        As `read_cut`; or an unknown kind, or a folder that cannot be written to.
    """
    if kind not in FORMATS:
        raise InputError(f"figures cannot be written as '{kind}'; there are: {', '.join(FORMATS)}")
    cut = read_cut(directory)
    target = Path(directory if figures is None else figures)
    make_writable(target)
    if figures is None:
        write_html(*cut, cut.title, target / "report.html")
        return [target / "report.html"]
    written = []
    for picture in pictures(*cut, leave_out):
        file = target / f"{picture.name}.{kind}"
        picture.figure.savefig(file)
        written.append(file)
    return written
