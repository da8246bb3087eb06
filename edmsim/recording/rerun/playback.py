"""Reading a recording: checks of completeness and version, and its contents at a time."""

import json
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rerun.chunk import Chunk, RrdReader

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import PART, folder_of
from edmsim.recording.report import RECORDING

APPLICATION = "edmsim"  # application id of recordings in the viewer
TIME = "machine_time"  # timeline of machine time, a duration
PATH = "path_um"  # timeline of the place along the wire path, in whole um
FORMAT = 2  # of the recording's layout, incremented with every change that an older reader would misread
MADE_BY = "made_by"  # entity with JSON: format, version that wrote the recording, and sizes for its views
_MARK = b"RRF2"  # first bytes of a recording; then follows the version of rerun that wrote it
_MADE = (f"/{MADE_BY}", "TextDocument:text")


@refuses_wrong_types
def find_recording(directory: str | Path) -> Path:
    """Return the path of the recording in a cut's folder, checked.

    Raises
    ------
    InputError
        If folder or recording is missing, or the file is damaged, incomplete, of another format or version.
    """
    folder = folder_of(directory)
    if folder.is_file():
        raise InputError(
            "a file, give the folder that `edmsim cut --out` wrote; the command rerun shows a recording by itself",
            directory,
        )
    if not folder.is_dir():
        raise InputError("no such folder, give the folder that `edmsim cut --out` wrote", directory)
    recording = folder / RECORDING
    if not recording.is_file():
        half = " but one half-written," if any(folder.glob(f"{RECORDING}.*{PART}")) else ","
        raise InputError(
            f"there is no {RECORDING} in it{half} give the folder of a finished `edmsim cut`", directory
        )
    read_chunks(recording)
    return recording


def read_chunks(recording: Path) -> list[Chunk]:
    """Return all of a recording's data."""
    _check_rerun(recording)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # if a file ends early between two messages, rerun only warns
            reader = RrdReader(recording)
            found = reader.recordings()
            chunks = list(reader.stream().to_chunks()) if found else []
    except (RuntimeError, ValueError, OSError, Warning):
        found = []
    if not found:
        size = recording.stat().st_size
        raise InputError(f"these {size} bytes are not a whole rerun recording, run the cut again", recording)
    _check_version(recording, found[0].application_id, chunks)
    return chunks


def _check_rerun(recording: Path) -> None:
    """Refuse a file of a newer rerun, which this one might misread with only a warning."""
    try:
        with recording.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}; give a cut's {RECORDING}", recording) from None
    here = tuple(int(number) for number in version("rerun-sdk").split(".")[:2])
    if head[:4] == _MARK and tuple(head[4:6]) > here:
        raise InputError(
            f"this recording was written by rerun {head[4]}.{head[5]}, and {here[0]}.{here[1]} is installed; "
            "run the cut again",
            recording,
        )


def _check_version(recording: Path, application: str, chunks: list[Chunk]) -> None:
    if application != APPLICATION:
        raise InputError(f"this is a recording of {application}, one that `edmsim cut` wrote is needed", recording)
    found = [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == _MADE[0]]
    made = json.loads(found[0].column(_MADE[1])[0].as_py()[0]) if found else {"format": 1}  # format 1 wrote none
    if made["format"] != FORMAT:
        by = f", written by edmsim {made['version']}" if "version" in made else ""
        raise InputError(
            f"this recording has format {made['format']}{by}; this edmsim reads format {FORMAT}, run the cut again",
            recording,
        )


class Sizes(NamedTuple):
    """Sizes of a cut for the views; the recording stores them, so that its layout can be made again."""

    size_mm: float  # largest of the drawing's sides and the workpiece's height
    height_mm: float  # of the workpiece
    wire_diameter_um: float
    x0_mm: float  # x0_mm, y0_mm, x1_mm, y1_mm: box around the drawing
    y0_mm: float
    x1_mm: float
    y1_mm: float
    # deflection_factor, error_factor: scale at which the wire's deflection and the profile error are drawn
    deflection_factor: float
    error_factor: float
    end_s: float  # machine time at the end


class Rows(NamedTuple):
    """A component of an entity over time, rows in order of time."""

    t_s: NDArray[np.float64]  # t_s, path_um: machine time and place along the path; 0 for static data
    path_um: NDArray[np.float64]
    values: pa.Array  # a list per row

    def at(self, t_s: float) -> int:
        """Return the row that is valid at a time; -1 before the first."""
        return int(np.searchsorted(self.t_s, t_s, side="right")) - 1


class Playback:
    """The data of a recording.

    Parameters
    ----------
    recording : path
        ``cut.rrd`` of a cut.

    Raises
    ------
    InputError
        As `find_recording`.
    """

    @refuses_wrong_types
    def __init__(self, recording: str | Path) -> None:
        self.recording = Path(recording)
        parts: dict[tuple[str, str], list[Rows]] = {}
        for chunk in read_chunks(self.recording):
            if chunk.timeline_names and TIME not in chunk.timeline_names:
                continue  # copy of a curve on the timeline of its pass
            batch = chunk.to_record_batch()
            times, path = np.zeros(batch.num_rows), np.zeros(batch.num_rows)
            if TIME in batch.schema.names:
                times = batch.column(TIME).to_numpy(zero_copy_only=False).astype(np.int64) * 1e-9
                path = batch.column(PATH).to_numpy(zero_copy_only=False).astype(np.float64)
            for name in batch.schema.names:
                if ":" in name:
                    parts.setdefault((chunk.entity_path, name), []).append(Rows(times, path, batch.column(name)))
        self._rows = {key: _in_order(found) for key, found in parts.items()}

    def __contains__(self, key: tuple[str, str]) -> bool:
        """Return whether there is a component, by entity and name."""
        return key in self._rows

    def rows(self, entity: str, component: str) -> Rows:
        """Return a component of an entity; raises `KeyError` if it is missing."""
        return self._rows[entity, component]

    def series(self, entity: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times in s and values of a curve; both empty if it is missing."""
        if (entity, "Scalars:scalars") not in self:
            return np.zeros(0), np.zeros(0)
        found = self.rows(entity, "Scalars:scalars")
        return found.t_s, np.asarray(found.values.flatten(), np.float64)

    def strips(self, entity: str, component: str, t_s: float) -> list[NDArray[np.float32]]:
        """Return an entity's lines at a time, each (points, 2 or 3)."""
        row = self._row(entity, component, t_s)
        return [] if row is None else [np.array(line, np.float32) for line in row.as_py()]

    def points(self, entity: str, component: str, t_s: float) -> NDArray[Any]:
        """Return an entity's vectors, colours or other numbers at a time: (n,) or (n, k), or empty (0,)."""
        row = self._row(entity, component, t_s)
        return np.zeros(0) if row is None else np.array(row.as_py())

    def _row(self, entity: str, component: str, t_s: float) -> pa.Scalar | None:
        found = self._rows.get((entity, component))
        at = -1 if found is None else found.at(t_s)
        return None if found is None or at < 0 or not found.values[at].is_valid else found.values[at]

    @property
    def title(self) -> str:
        """The cut's title."""
        return str(self.rows("/__properties", "RecordingInfo:name").values[0].as_py()[0])

    @property
    def sizes(self) -> Sizes:
        """Sizes of the cut for the views."""
        return Sizes(*json.loads(self.rows(*_MADE).values[0].as_py()[0])["sizes"])

    @property
    def end_s(self) -> float:
        """Machine time in s at the end; 0 without a record."""
        return max((float(rows.t_s[-1]) for rows in self._rows.values() if len(rows.t_s)), default=0.0)


def _in_order(found: list[Rows]) -> Rows:
    times = np.concatenate([rows.t_s for rows in found])
    path = np.concatenate([rows.path_um for rows in found])
    values = pa.concat_arrays([rows.values for rows in found])
    order = np.argsort(times, kind="stable")
    return Rows(times[order], path[order], values.take(pa.array(order)))
