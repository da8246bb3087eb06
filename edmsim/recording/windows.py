"""The table of windows: a row per 255 counted pulses; and the times at which a machine cuts.

A *pause* lies between two windows: the wire is threaded, and brought to where the next contour begins by a way in
air. No pulse is fired, so it has no windows, and lines over time or along the path break there. A *stretch* is what
lies between two pauses.

*The cut alone* is, of every stretch, the time from when the wire's centre leaves the start hole, and with its whole
width is in metal, to the last discharge. What comes before is a way in air and the bite into the hole's wall; behind
it, the wire runs in its own kerf. Threading, ways between contours and start holes are no part of it; retracts,
shorts and dwells are. Every picture, figure and table takes that from here.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.observers import Observer, PlantView, Turn
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import make_writable, replacing
from edmsim.geometry import Floats
from edmsim.snapshots import ArraySnapshots

if TYPE_CHECKING:
    import pyarrow as pa

THREADING_S = 1.0  # least time that it takes to thread a wire (ours)
_JUMP_UM = 20.0
"""A way longer than the path cut meanwhile by more than this is one between contours (ours: rounding is 1 um)."""


class CutAlone(NamedTuple):
    """The cut alone: of the windows, of the time, and of the path."""

    rows: NDArray[np.bool_]  # (n,): whether a window belongs to it
    time_s: float
    # from and to which place along the path the wire has cut, stretch by stretch
    ways_um: tuple[tuple[float, float], ...]


def cut_alone(t_s: Floats, place_um: Floats, path_um: Floats, ignited: Floats, holes_um: Floats) -> CutAlone:
    """Return what of a cut's windows is the cut alone; start holes are rows of centre and radius on the table."""
    away = np.hypot(place_um[:, None, 0] - holes_um[:, 0], place_um[:, None, 1] - holes_um[:, 1])
    in_hole: NDArray[np.bool_] = np.any(away <= holes_um[:, 2], axis=1)
    rows, time_s, ways = np.zeros(len(t_s), bool), 0.0, []
    for part in stretches(len(t_s), pause_rows(t_s)):
        outside = part.start + np.flatnonzero(~in_hole[part])
        lit = part.start + np.flatnonzero(ignited[part] > 0)
        if len(outside) and len(lit) and lit[-1] >= outside[0]:
            first, last = max(int(outside[0]), part.start + 1), int(lit[-1])
            rows[first : last + 1] = True
            time_s += float(t_s[last] - t_s[first - 1])
            ways.append((float(path_um[first - 1]), float(path_um[first - 1 : last + 1].max())))
    return CutAlone(rows, time_s, tuple(ways))


def pause_rows(t_s: Floats) -> NDArray[np.intp]:
    """Return the rows of the table of windows, times (n,), before which a wire was threaded."""
    # windows may be long, of long periods or thinned; a pause is longer than those beside it
    took = np.diff(t_s)
    neighbours = np.concatenate([t_s[:1], took, [np.inf]])
    return np.flatnonzero(took > THREADING_S + 2.0 * np.minimum(neighbours[: len(took)], neighbours[2:])) + 1


def jump_rows(place_um: Floats, path_um: Floats) -> NDArray[np.intp]:
    """Return the rows of a thinned way, places (n, 2) and lengths of path (n,), before which a wire was threaded."""
    way = np.hypot(*np.diff(place_um, axis=0).T)
    return np.flatnonzero(way > np.abs(np.diff(path_um)) + _JUMP_UM) + 1


def stretches(count: int, breaks: NDArray[np.intp]) -> list[slice]:
    """Return the rows between breaks, stretch by stretch."""
    edges = [0, *breaks.tolist(), count]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def broken(values: Floats, breaks: NDArray[np.intp]) -> Floats:
    """Return values (n, ...) with NaN before every break, so that a line drawn through them stops there."""
    return np.insert(values, breaks, np.nan, axis=0)


def group_means(values: Floats, starts: NDArray[np.integer]) -> Floats:
    """Return the mean of every group of neighbours; `starts` are their first rows. NaN is left out."""
    known = np.isfinite(values)
    counts = np.add.reduceat(known.astype(float), starts)
    sums = np.add.reduceat(np.where(known, values, 0.0), starts)
    return np.asarray(np.divide(sums, counts, out=np.full(len(starts), np.nan), where=counts > 0))


class Column(NamedTuple):
    """What one column of the table holds: its name, its unit ("1" if none) and its meaning."""

    name: str
    unit: str
    meaning: str
    is_count: bool = False


COLUMNS: tuple[Column, ...] = (
    Column("t_s", "s", "machine time at the end of the window"),
    Column("x_um", "um", "commanded position of the wire guides on the table, X"),
    Column("y_um", "um", "commanded position of the wire guides on the table, Y"),
    Column("feed_um_s", "um/s", "mean feed along the path; negative while retracting"),
    Column("short", "1", "pulses counted as short circuit: no removal", is_count=True),
    Column("open", "1", "pulses that never ignited: no removal", is_count=True),
    Column("spark", "1", "pulses that ignited after a delay and removed metal", is_count=True),
    Column("arc", "1", "pulses that ignited at once on the previous channel", is_count=True),
    Column("mean_voltage_V", "V", "gap voltage of the working pulses, averaged over the window"),
    Column("mean_current_A", "A", "gap current averaged over the window"),
    Column("mean_delay_us", "us", "mean ignition delay; NaN if no pulse ignited"),
    Column("gap_um", "um", "mean gap where the pulses ignited"),
    Column("lag_x_um", "um", "guides minus wire at the workpiece, X: positive behind a feed along +X"),
    Column("lag_y_um", "um", "guides minus wire at the workpiece, Y: positive behind a feed along +Y"),
    Column("following_x_um", "um", "commanded position minus guides, X: the drive's following error"),
    Column("following_y_um", "um", "commanded position minus guides, Y"),
    Column("wire_temperature_K", "K", "hottest place of the wire; NaN if there is none"),
    Column("debris", "1", "volume share of debris in the gap's fluid"),
    Column("coverage", "1", "share of the wire's front that gas covers, at the window's end"),
    Column("t_on_us", "us", "pulse on-time t_i set for the window"),
    Column("t_period_us", "us", "pulse period t_p set for the window"),
    Column("path_um", "um", "place along the wire path, from the first start hole"),
    Column("error_um", "um", "profile error of the cut where the wire was; positive: metal left; NaN if none"),
)
"""Columns of ``windows.parquet``, in order."""

EQUALISING_COLUMNS: tuple[Column, ...] = (
    Column("net_voltage_V", "V", "gap voltage averaged over the window with its sign, equalising pulses included"),
    Column("equalising_W", "W", "power that the supply of the equalising pulses gives"),
)
"""Columns behind those, of a generator with equalising pulses."""

CUT_KEY = b"edmsim_cut"
"""Under which the metadata of ``windows.parquet`` say which cut they are of: `edmsim.recording.report.cut_id`."""

NAMES: tuple[str, ...] = tuple(column.name for column in COLUMNS)  # names of all columns, in order

ROW_NAMES: tuple[str, ...] = NAMES[:-1]
"""What `WindowTable.append` takes: everything but ``error_um``, which only the finished cut can tell."""


class WindowTable(ArraySnapshots, Observer):
    """Rows of a cut in progress, with `EQUALISING_COLUMNS` if the generator has such pulses; read at the end."""

    name: ClassVar[str] = "windows"
    STATE = ("rows",)

    def __init__(self, equalising: bool = False) -> None:
        self._more = EQUALISING_COLUMNS if equalising else ()
        self._width = len(ROW_NAMES) + len(self._more)
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._values) // self._width

    def window(self, turn: Turn, plant: PlantView) -> None:
        """Add a window of a cut."""
        window, machine, opposite = turn.window, plant.machine, turn.opposite
        more = (window.mean_voltage_V, 0.0) if opposite is None else (opposite.net_voltage_V, opposite.power_W)
        self.append((
            turn.time_ns * 1e-9, *plant.commanded_um, turn.feed_um_s, window.short, window.open, window.spark,
            window.arc, window.mean_voltage_V, window.mean_current_A, window.mean_delay_us, window.gap_um,
            -window.deflection_um[0], -window.deflection_um[1], *plant.following_error_um,
            window.wire_temperature_K, window.debris, window.coverage, machine.t_on_us, machine.t_period_us,
            turn.path_um, *more[: len(self._more)],
        ))  # fmt: skip

    def append(self, row: Sequence[float]) -> None:
        """Add one window: the values of `ROW_NAMES`, then those of `EQUALISING_COLUMNS`, if the table has them."""
        self._values.extend(row)

    @property
    def rows(self) -> Floats:
        """A copy of all rows, columns as `append` takes them."""
        return np.array(self._values).reshape(-1, self._width)

    @rows.setter
    def rows(self, rows: Floats) -> None:
        self._values = array("d", rows.tobytes())

    def columns(self) -> dict[str, Floats]:
        """Return a copy of all columns by name."""
        return dict(zip((*ROW_NAMES, *(column.name for column in self._more)), self.rows.T, strict=True))

    def ways_um(self) -> tuple[Floats, ...]:
        """Return commanded position, following error and wire lag, (len(self), 2) each, time in s, and path in um."""
        values = self.rows
        x, following, lag, time, path = map(ROW_NAMES.index, ("x_um", "following_x_um", "lag_x_um", "t_s", "path_um"))
        return *(values[:, k : k + 2] for k in (x, following, lag)), values[:, time], values[:, path]

    def to_arrow(self, error_um: Floats | None = None) -> pa.Table:
        """Return the table as `windows.parquet` holds it; the metadata of each field say ``unit`` and ``meaning``."""
        import pyarrow as pa

        values = self.rows
        error = np.full(len(values), np.nan) if error_um is None else np.asarray(error_um, np.float64)
        if error.shape != (len(values),):
            raise ValueError(f"error_um has shape {error.shape}, the table has {len(values)} windows")
        data = [*np.ascontiguousarray(values.T)]
        data.insert(len(ROW_NAMES), error)
        columns = COLUMNS + self._more
        fields = [
            pa.field(
                c.name, pa.int16() if c.is_count else pa.float64(), nullable=False,
                metadata={"unit": c.unit, "meaning": c.meaning},
            )
            for c in columns
        ]
        arrays = [
            pa.array(column.astype(np.int16) if c.is_count else column)
            for c, column in zip(columns, data, strict=True)
        ]
        return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def write_windows(table: pa.Table, file: str | Path) -> None:
    """Write a table of windows as Parquet, making the folder; a file of that name is replaced whole or not at all."""
    import pyarrow.parquet as pq

    make_writable(Path(file).parent)
    # by a name, only folders whose names are UTF-8 could be written to
    with replacing(file) as partial, partial.open("wb") as opened:
        pq.write_table(table, opened)


@refuses_wrong_types
def read_windows(file: str | Path) -> pa.Table:
    """Read a ``windows.parquet``.

    Raises
    ------
    InputError
        If the file is missing, not Parquet, or lacks a column of `NAMES`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with Path(file).open("rb") as opened:
            table = pq.read_table(opened)
        assert table.column_names is not None  # which are decoded only here
    except FileNotFoundError:
        raise InputError("no such file, a windows.parquet written by a cut is needed", file) from None
    except (pa.ArrowException, OSError, UnicodeError):
        raise InputError("not a Parquet file, a windows.parquet written by a cut is needed", file) from None
    missing = [name for name in NAMES if name not in table.column_names]
    if missing:
        raise InputError(f"column {missing[0]} is missing, expected {' '.join(NAMES)}", file)
    return table


def column(table: pa.Table, name: str) -> Floats:
    """Return one column of a table of windows as a float64 array."""
    return np.asarray(table.column(name).to_numpy(), np.float64)


def columns(table: pa.Table, *names: str) -> Floats:
    """Return some columns of a table of windows side by side, as `column` has them: (n, names)."""
    return np.column_stack([column(table, name) for name in names])


def travel_direction(table: pa.Table) -> Floats:
    """Return the direction of travel in every window, unit vectors (n, 2); zero where the wire has not moved."""
    # the chord over 25 um of path on either side: steps of 1 um on two axes say nothing about direction
    # one by one; it never reaches over a pause, to another contour
    path = np.maximum.accumulate(column(table, "path_um"))
    place = columns(table, "x_um", "y_um")
    chord = np.zeros((len(path), 2))
    for part in stretches(len(path), pause_rows(column(table, "t_s"))):
        s, at = path[part], place[part]
        chord[part] = np.column_stack([np.interp(s + 25.0, s, x) - np.interp(s - 25.0, s, x) for x in at.T])
    length = np.hypot(chord[:, 0], chord[:, 1])
    return np.asarray(np.divide(chord, length[:, None], out=np.zeros_like(chord), where=length[:, None] > 0))


def lag_along_um(table: pa.Table) -> Floats:
    """Wire lag of every window in um along the direction of travel: positive against the feed."""
    return np.asarray(np.einsum("ij,ij->i", columns(table, "lag_x_um", "lag_y_um"), travel_direction(table)))
