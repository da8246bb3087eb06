"""The record of a cut: the table of windows, a row per 255 counted pulses; frames of the wire; close-ups.

A *pause* is between two windows: the wire is threaded and moved through air to the begin of the next contour. No
pulse is fired, so a pause has no windows, and lines over time or along the path are interrupted. A *stretch* is the
windows between two pauses.

*The cut alone* is, of every stretch, the time from when the wire's centre leaves the start hole, so that its whole
width is in metal, to the last discharge. Before, the wire moves in air and cuts into the hole's wall; afterwards, it
moves in its own kerf. Threading, moves between contours and start holes do not belong to the cut alone; retracts,
shorts and dwells do. All pictures, figures and tables use this definition.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.closed_loop.cycle import CycleResult, PlantView, Recorder
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import make_writable, replacing
from edmsim.geometry import CORNER_DEG, Floats, Polyline
from edmsim.plant.gap.generator import pulse_lengths_us
from edmsim.plant.kernel.state import ARC, OPEN, PULSE, SHORT, SPARK
from edmsim.snapshots import ArraySnapshots

if TYPE_CHECKING:
    import pyarrow as pa


_KINDS = {OPEN: "open", SPARK: "spark", ARC: "arc", SHORT: "short"}
THREADING_S = 1.0  # least time for threading a wire (ours)
_JUMP_UM = 20.0
"""A move that is longer by this than the path cut meanwhile is between contours (ours: rounding is 1 um)."""


class CutAlone(NamedTuple):
    """The windows, time and path of the cut alone."""

    rows: NDArray[np.bool_]  # (n,): whether a window belongs to the cut alone
    time_s: float
    # places along the path between which the wire has cut, per stretch
    stretches_um: tuple[tuple[float, float], ...]


def cut_alone(values: Mapping[str, Floats], holes_um: Floats) -> CutAlone:
    """Return the cut alone, from the columns of a cut's windows; start holes are centres and radii."""
    t_s, path_um, ignited = values["t_s"], values["path_um"], values["spark"] + values["arc"]
    away = np.hypot(values["x_um"][:, None] - holes_um[:, 0], values["y_um"][:, None] - holes_um[:, 1])
    in_hole: NDArray[np.bool_] = np.any(away <= holes_um[:, 2], axis=1)
    rows, time_s, found = np.zeros(len(t_s), bool), 0.0, []
    for part in stretches(len(t_s), pause_rows(t_s)):
        outside = part.start + np.flatnonzero(~in_hole[part])
        lit = part.start + np.flatnonzero(ignited[part] > 0)
        if len(outside) and len(lit) and lit[-1] >= outside[0]:
            first, last = max(int(outside[0]), part.start + 1), int(lit[-1])
            rows[first : last + 1] = True
            time_s += float(t_s[last] - t_s[first - 1])
            found.append((float(path_um[first - 1]), float(path_um[first - 1 : last + 1].max())))
    return CutAlone(rows, time_s, tuple(found))


def pause_rows(t_s: Floats) -> NDArray[np.intp]:
    """Return the rows of the table of windows, times (n,), before which a wire was threaded."""
    # a pause is longer than its neighbours; windows may be long, too, because of long periods or thinning
    took = np.diff(t_s)
    neighbours = np.concatenate([t_s[:1], took, [np.inf]])
    return np.flatnonzero(took > THREADING_S + 2.0 * np.minimum(neighbours[: len(took)], neighbours[2:])) + 1


def durations_s(values: Mapping[str, Floats]) -> Floats:
    """Return the windows' durations, from their columns; longer than their periods if pulses last longer.

    The first window after a pause counts with its periods, because its begin is not in the table.
    """
    pulses = values["short"] + values["open"] + values["spark"] + values["arc"]
    took, after = np.diff(values["t_s"], prepend=0.0), pause_rows(values["t_s"])
    took[after] = (pulses * values["t_period_us"])[after] * 1e-6
    return took


def jump_rows(place_um: Floats, path_um: Floats) -> NDArray[np.intp]:
    """Return the rows before which a wire was threaded, from thinned places (n, 2) and lengths of path (n,)."""
    moved_um = np.hypot(*np.diff(place_um, axis=0).T)
    return np.flatnonzero(moved_um > np.abs(np.diff(path_um)) + _JUMP_UM) + 1


def stretches(count: int, breaks: NDArray[np.intp]) -> list[slice]:
    """Return the rows of each stretch between breaks."""
    edges = [0, *breaks.tolist(), count]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def broken(values: Floats, breaks: NDArray[np.intp]) -> Floats:
    """Return values (n, ...) with NaN before every break, which interrupts a line drawn through them."""
    return np.insert(values, breaks, np.nan, axis=0)


def group_means(values: Floats, starts: NDArray[np.integer]) -> Floats:
    """Return the mean of every group of successive values, without NaN; `starts` are the groups' first rows."""
    known = np.isfinite(values)
    counts = np.add.reduceat(known.astype(float), starts)
    sums = np.add.reduceat(np.where(known, values, 0.0), starts)
    return np.asarray(np.divide(sums, counts, out=np.full(len(starts), np.nan), where=counts > 0))


class Column(NamedTuple):
    """A column of the table: its name, its unit ("1" if none) and its meaning."""

    name: str
    unit: str
    meaning: str
    is_count: bool = False


COLUMNS: tuple[Column, ...] = (
    Column("t_s", "s", "machine time at the end of the window"),
    Column("x_um", "um", "commanded position of the wire guides on the table, X"),
    Column("y_um", "um", "commanded position of the wire guides on the table, Y"),
    Column("feed_um_s", "um/s", "feed along the path, at the end of the window; negative while retracting"),
    Column("short", "1", "pulses counted as short circuit: hardly any removal", is_count=True),
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
"""Columns after those, if the generator has equalising pulses."""

CUT_KEY = b"edmsim_cut"
"""Key of the cut's identity, `edmsim.recording.report.cut_id`, in the metadata of ``windows.parquet``."""

NAMES: tuple[str, ...] = tuple(column.name for column in COLUMNS)  # names of all columns, in order
ROW_NAMES: tuple[str, ...] = NAMES[:-1]
"""Columns of a row for `WindowTable.append`: all but ``error_um``, which is known only after the cut."""


_Pair = tuple[float, float]


def row_of(result: CycleResult, commanded_um: _Pair, following_um: _Pair, setting_us: _Pair) -> tuple[float, ...]:
    """Return the values of `ROW_NAMES` of a window; `setting_us` is the generator's on-time and period."""
    window = result.window
    return (
        result.time_ns * 1e-9, *commanded_um, result.feed_um_s, window.short, window.open, window.spark, window.arc,
        window.mean_voltage_V, window.mean_current_A, window.mean_delay_us, window.gap_um, -window.deflection_um[0],
        -window.deflection_um[1], *following_um, window.wire_temperature_K, window.debris, window.coverage,
        *setting_us, result.path_um,
    )  # fmt: skip


class WindowTable(ArraySnapshots, Recorder):
    """Rows of a cut in progress, with `EQUALISING_COLUMNS` if the generator has such pulses; read at the end."""

    name: ClassVar[str] = "windows"
    STATE = ("rows",)

    def __init__(self, equalising: bool = False) -> None:
        self._more = EQUALISING_COLUMNS if equalising else ()
        self._width = len(ROW_NAMES) + len(self._more)
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._values) // self._width

    def window(self, result: CycleResult, plant: PlantView) -> None:
        """Add a window of a cut."""
        machine, opposite = plant.machine, result.opposite
        more = (result.window.mean_voltage_V, 0.0) if opposite is None else (opposite.net_voltage_V, opposite.power_W)
        setting_us = machine.t_on_us, machine.t_period_us
        row = row_of(result, plant.commanded_um, plant.following_error_um, setting_us)
        self.append((*row, *more[: len(self._more)]))

    def append(self, row: Sequence[float]) -> None:
        """Add one window: the values of `ROW_NAMES`, then those of `EQUALISING_COLUMNS`, if the table has them."""
        self._values.extend(row)

    @property
    def rows(self) -> Floats:
        """A copy of all rows, with columns as in `append`."""
        return np.array(self._values).reshape(-1, self._width)

    @rows.setter
    def rows(self, rows: Floats) -> None:
        self._values = array("d", rows.tobytes())

    def columns(self) -> dict[str, Floats]:
        """Return a copy of all columns by name."""
        return dict(zip((*ROW_NAMES, *(column.name for column in self._more)), self.rows.T, strict=True))

    def motion(self) -> tuple[Floats, ...]:
        """Return commanded position, following error and wire lag, (len(self), 2) each, time in s, and path in um."""
        values = self.rows
        x, following, lag, time, path = map(ROW_NAMES.index, ("x_um", "following_x_um", "lag_x_um", "t_s", "path_um"))
        return *(values[:, k : k + 2] for k in (x, following, lag)), values[:, time], values[:, path]

    def to_arrow(self, error_um: Floats | None = None) -> pa.Table:
        """Return the table of `windows.parquet`; each field's metadata have ``unit`` and ``meaning``."""
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
    """Write a table of windows as Parquet and make its folder; an existing file is replaced only when complete."""
    import pyarrow.parquet as pq

    make_writable(Path(file).parent)
    # opened here, because pyarrow opens only paths that are UTF-8
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
        assert table.column_names is not None  # decodes the names, which may raise UnicodeError
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
    """Return columns of a table of windows as a float64 array (n, names)."""
    return np.column_stack([column(table, name) for name in names])


def travel_direction(table: pa.Table) -> Floats:
    """Return the direction of travel in every window, unit vectors (n, 2); zero if the wire has not moved."""
    # the chord over 25 um of path on either side, because single steps of 1 um have only the axes' directions;
    # it does not extend over a pause to another contour
    path = np.maximum.accumulate(column(table, "path_um"))
    place = columns(table, "x_um", "y_um")
    chord = np.zeros((len(path), 2))
    for part in stretches(len(path), pause_rows(column(table, "t_s"))):
        s, at = path[part], place[part]
        chord[part] = np.column_stack([np.interp(s + 25.0, s, x) - np.interp(s - 25.0, s, x) for x in at.T])
    length = np.hypot(chord[:, 0], chord[:, 1])
    return np.asarray(np.divide(chord, length[:, None], out=np.zeros_like(chord), where=length[:, None] > 0))


def lag_along_um(table: pa.Table) -> Floats:
    """Return the wire's lag in every window in um along the direction of travel: positive against the feed."""
    return np.asarray(np.einsum("ij,ij->i", columns(table, "lag_x_um", "lag_y_um"), travel_direction(table)))


def quantity(table: pa.Table, name: str) -> Floats:
    """Return a series to draw: a column, ``lag_um`` along the feed, or a class of pulses in percent."""
    if name == "lag_um":
        return lag_along_um(table)
    if name not in _KINDS.values():
        return column(table, name)
    pulses = columns(table, *_KINDS.values()).sum(axis=1)
    return np.asarray(100.0 * column(table, name) / np.maximum(pulses, 1.0))


# Stores of bounded size for a cut of any length: frames of wire and gas, and windows pulse by pulse.
#
# The longer the cut, the larger the part of the frames that is dropped. Close-ups are windows at equal intervals over
# the whole cut, and all windows around events. The selection depends only on the windows, so equal cuts have equal
# frames and close-ups.

Bytes = NDArray[np.uint8]  # rows as bytes, (size,) or (n, size)


def bytes_of(rows: NDArray[np.void]) -> Bytes:
    """Return a view of rows (..., n) as bytes (..., n, size), which numpy copies twenty times as fast as records."""
    return rows.view(np.uint8).reshape(*rows.shape, rows.itemsize)


class Thinned(ArraySnapshots):
    """Store of every `stride`-th row. The stride doubles whenever it is full, so equal cuts store equal rows."""

    STATE = ("rows", "_offered", "stride")

    def __init__(self, kind: np.dtype[np.void], capacity: int) -> None:
        if capacity < 2:
            raise ValueError(f"a capacity of {capacity} is too small, at least 2 rows are needed")
        self._rows = np.zeros(capacity, kind)
        self._bytes = bytes_of(self._rows)
        self.stride = 1
        self._offered = self._used = 0

    def __len__(self) -> int:
        return self._used

    @property
    def wants_next(self) -> bool:
        """Whether the next row will be stored; if not, `skip` does the same as `offer`."""
        return self._offered % self.stride == 0

    def skip(self) -> None:
        """Count a row that will not be stored."""
        self._offered += 1

    def offer(self, row: Bytes) -> None:
        """Store a row, as bytes, if its number is a multiple of the stride."""
        if self.wants_next and self._used == len(self._rows):
            self._halve()
        if self.wants_next:
            self._bytes[self._used] = row
            self._used += 1
        self._offered += 1

    def _halve(self) -> None:
        rows = self._bytes[: self._used : 2].copy()
        self._used = len(rows)
        self._bytes[: self._used] = rows
        self.stride *= 2

    @property
    def rows(self) -> NDArray[np.void]:
        """Stored rows, (n,)."""
        return self._rows[: self._used]

    @rows.setter
    def rows(self, rows: NDArray[np.void]) -> None:
        if rows.dtype != self._rows.dtype or len(rows) > len(self._rows):
            raise ValueError(
                f"a snapshot of {len(rows)} rows of type {rows.dtype} does not fit {len(self._rows)} of type "
                f"{self._rows.dtype}"
            )
        self._used = len(rows)
        self._rows[: self._used] = rows


class Frames(ArraySnapshots, Recorder):
    """The wire's shape and gas in every `stride`-th window, stored in a `Thinned`."""

    name: ClassVar[str] = "frames"
    STATE = ("_thinned",)

    def __init__(self, n_slices: int, capacity: int = 2000) -> None:
        self.n_slices = n_slices
        kind = [
            ("t_s", "f8"), ("guides_um", "f8", 2), ("path_um", "f8"),
            ("deflection_um", "f8", (n_slices, 2)),  # per slice from the bottom
            ("coverage", "f4", (n_slices,)),  # share of the wire's front that gas covers
        ]  # fmt: skip
        self._row: NDArray[np.void] = np.zeros(1, np.dtype(kind))
        self._thinned = Thinned(self._row.dtype, capacity)

    def __len__(self) -> int:
        return len(self._thinned)

    @property
    def stride(self) -> int:
        """Windows from one stored frame to the next."""
        return self._thinned.stride

    def window(self, result: CycleResult, plant: PlantView) -> None:
        """Store a window if its number is a multiple of the stride."""
        if self._thinned.wants_next:
            place = plant.commanded_um, result.path_um
            self.offer(result.time_ns * 1e-9, *place, plant.deflections_um(), plant.coverage())
        else:
            self._thinned.skip()

    def offer(self, *row: object) -> None:
        """Store a frame, the values of `rows`, if its number is a multiple of the stride."""
        self._row[0] = row
        self._thinned.offer(bytes_of(self._row)[0])

    @property
    def rows(self) -> NDArray[np.void]:
        """Stored frames, (n,): machine time, guides on the table, place along the path, wire minus guides, gas."""
        return self._thinned.rows.copy()


PULSES = 96  # number of a window's last pulses that are stored
REGULAR = 600  # most close-ups at equal intervals over the whole cut
AROUND = 20  # windows stored before and after an event: half a second each at a period of 100 us
BLOCKS = 40  # most events of a kind with close-ups around them
NOTHING, RETRACT, TURN = 0, 1, 2
"""Events with close-ups around them: the wire begins to retract; it passes a corner or begins a contour."""


def row_type(slices: int, rays: int) -> np.dtype[np.void]:
    """Return the type of a close-up for a resolution."""
    return np.dtype(
        [
            ("t_s", "f8"), ("guides_um", "f8", 2), ("path_um", "f8"), ("burning_V", "f4"), ("current_A", "f4"),
            ("short_A", "f4"), ("opposite_V", "f4"), ("opposite_A", "f4"), ("wire_um", "f8", 2),
            ("walls_um", "f4", rays), ("deflection_um", "f4", (slices, 2)), ("coverage", "f4", (slices,)),
            ("pulses", PULSE, PULSES), ("count", "i4"),
        ]
    )


def turns_um(points_um: NDArray[np.int64]) -> list[float]:
    """Return the lengths along a polyline (n, 2) at which it turns by `CORNER_DEG` or more, and 0 for its begin."""
    line = Polyline(points_um.astype(np.float64), closed=False)
    return [0.0, *line.s[line.corners(CORNER_DEG)].tolist()]


class Blocks(ArraySnapshots):
    """Blocks of rows around events; if there are too many, every second one is deleted and the spacing doubled."""

    STATE = ("_lengths", "rows", "_spacing", "_free_from", "_rows_left")

    def __init__(self, kind: np.dtype[np.void]) -> None:
        self._rows = np.zeros((BLOCKS, 2 * AROUND + 1), kind)
        self._bytes = bytes_of(self._rows)
        self._lengths: list[int] = []
        self._spacing = 2 * AROUND + 1
        self._free_from = 0
        self._rows_left = 0

    def offer(self, number: int, row: Bytes, before: Bytes, happened: bool) -> None:
        """Store row `number`, as bytes, if it is near an event; `happened` is whether it has one itself."""
        if self._rows_left > 0:
            self._add(row)
            self._rows_left -= 1
        elif happened and number >= self._free_from:
            if len(self._lengths) == BLOCKS:
                self._halve()
            self._lengths.append(len(before))
            self._bytes[len(self._lengths) - 1, : len(before)] = before
            self._add(row)
            self._rows_left, self._free_from = AROUND, number + self._spacing

    def _add(self, row: Bytes) -> None:
        self._bytes[len(self._lengths) - 1, self._lengths[-1]] = row
        self._lengths[-1] += 1

    def _halve(self) -> None:
        rows = self._bytes[::2].copy()
        self._lengths = self._lengths[::2]
        self._bytes[: len(rows)] = rows
        self._spacing *= 2

    @property
    def rows(self) -> NDArray[np.void]:
        """Rows of all blocks, one after the other."""
        return np.concatenate([self._rows[0, :0], *(self._rows[i, :n] for i, n in enumerate(self._lengths))])

    @rows.setter
    def rows(self, rows: NDArray[np.void]) -> None:
        at = 0
        for i, length in enumerate(self._lengths):
            self._rows[i, :length] = rows[at : at + length]
            at += length


class Closeups(ArraySnapshots, Recorder):
    """Windows of a cut stored in full, with the wall of one slice."""

    name: ClassVar[str] = "closeups"
    STATE = ("_last", "_windows", "_turns_passed", "_feed_um_s", "_run", "_blocks")

    def __init__(self, slices: int, rays: int, slice_index: int) -> None:
        kind = row_type(slices, rays)
        self.slice_index = slice_index
        self._windows = 0
        self._last = np.zeros(AROUND + 1, kind)
        self._bytes = bytes_of(self._last)
        self._pulses_at = int(kind.fields["pulses"][1]) if kind.fields is not None else 0
        self._run = Thinned(kind, REGULAR)
        self._blocks = {RETRACT: Blocks(kind), TURN: Blocks(kind)}
        self._turns_um: list[float] = []
        self._turns_passed, self._feed_um_s = 0, 0.0

    def begin(self, plant: PlantView) -> None:
        """Make the plant store its pulses."""
        plant.watch_pulses()

    def leg(self, points_um: NDArray[np.int64], start_um: float) -> None:
        """Set the places along the path at which the leg turns."""
        self._turns_um, self._turns_passed = [start_um + turn for turn in turns_um(points_um)], 0

    def window(self, result: CycleResult, plant: PlantView) -> None:
        """Store a window, with its event if it has one."""
        row, timing = self.row, plant.timing
        row["t_s"], row["guides_um"], row["path_um"] = result.time_ns * 1e-9, plant.commanded_um, result.path_um
        row["burning_V"], row["current_A"], row["short_A"] = timing.burning_V, timing.current_A, timing.short_A
        opposite = result.opposite
        row["opposite_V"] = 0.0 if opposite is None else opposite.voltage_V
        row["opposite_A"] = 0.0 if opposite is None else opposite.current_A
        row["wire_um"], row["walls_um"] = plant.walls_um(self.slice_index)
        row["deflection_um"], row["coverage"] = plant.deflections_um(), plant.coverage()
        self._fill_pulses(plant.last_pulses())
        passed = bisect(self._turns_um, result.path_um)
        runs_back = result.feed_um_s < 0 <= self._feed_um_s
        event = TURN if passed != self._turns_passed else RETRACT if runs_back else NOTHING
        self._turns_passed, self._feed_um_s = passed, result.feed_um_s
        self.keep(event)

    @property
    def row(self) -> np.void:
        """The row to fill with the latest window, before `keep`."""
        row: np.void = self._last[self._windows % len(self._last)]
        return row

    def _fill_pulses(self, pulses: NDArray[np.void]) -> None:
        """Write the last pulses of the latest window (rows of `PULSE`) to `row`."""
        last = pulses[-PULSES:]
        at, begin = self._windows % len(self._last), self._pulses_at
        self._bytes[at, begin : begin + last.nbytes] = last.view(np.uint8)
        self._last[at]["count"] = len(last)

    def keep(self, event: int = NOTHING) -> None:
        """Store the filled `row`; `event` is that of its window."""
        at = self._windows % len(self._last)
        row = self._bytes[at]
        self._run.offer(row)
        older = self._bytes[at + 1 :] if self._windows >= len(self._last) else self._bytes[:0]
        before = self._bytes[:0] if event == NOTHING else np.concatenate([older, self._bytes[:at]])
        for kind, blocks in self._blocks.items():
            blocks.offer(self._windows, row, before, kind == event)
        self._windows += 1

    @property
    def stride(self) -> int:
        """Windows from one close-up to the next, away from events."""
        return self._run.stride

    def table(self) -> NDArray[np.void]:
        """Return all close-ups in order of time, (n,) rows of `row_type`, with those of the cut's last windows."""
        last = self._last[self._last["t_s"] > 0.0]
        everything = np.concatenate([self._run.rows, *(blocks.rows for blocks in self._blocks.values()), last])
        _, first = np.unique(everything["t_s"], return_index=True)
        return np.asarray(everything[first])

    def write_traces(self, file: str | Path, every_us: float, begin_s: float, end_s: float) -> None:
        """Write samples of the traces to a Parquet file; see `edmsim.CutResult.write_traces`."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        if not _TICK_US <= every_us < math.inf:
            raise InputError(f"every_us is {every_us:g}: the time between samples must be {_TICK_US:g} us or more")
        stored = self.table()
        closeups = stored[(stored["t_s"] >= begin_s) & (stored["t_s"] <= end_s)]
        if len(stored) and not len(closeups):
            first, last = stored["t_s"][[0, -1]]
            raise InputError(
                f"no window with samples ends between begin_s {begin_s:g} and end_s {end_s:g}: the cut has "
                f"{len(stored)}, from {first:.3f} to {last:.3f} s"
            )
        kind = pa.dictionary(pa.int8(), pa.string())
        schema = pa.schema([
            ("window_t_s", pa.float64()), ("time_us", pa.float64()), ("voltage_V", pa.float32()),
            ("current_A", pa.float32()), ("pulse", pa.int16()), ("kind", kind),
        ])  # fmt: skip
        names = pa.array([_KINDS[number] for number in sorted(_KINDS)])
        # opened here, because pyarrow opens only paths that are UTF-8
        with (
            replacing(file) as partial, partial.open("wb") as opened,
            pq.ParquetWriter(opened, schema, compression="zstd") as writer,
        ):
            for first in range(0, len(closeups), _TOGETHER):
                last = min(first + _TOGETHER, len(closeups))
                some = [_samples(closeups[i : i + 1], every_us) for i in range(first, last)]
                *columns, kinds = (np.concatenate(parts) for parts in zip(*some, strict=True))
                arrays = [pa.array(c, field.type) for c, field in zip(columns, schema, strict=False)]
                coded = pa.DictionaryArray.from_arrays(pa.array(kinds.astype(np.int8)), names)
                writer.write_table(pa.Table.from_arrays([*arrays, coded], schema=schema))


# Gap voltage and current of the close-ups' pulses: corners of the traces, and samples of them in a file.

_TICK_US = 1e-3  # the plant's clock
_TOGETHER = 32  # windows written at once (ours: some half a million samples, a few MB)


def traces(closeups: NDArray[np.void], count: int) -> tuple[Floats, Floats, Floats]:
    """Return time, voltage and current of the last pulses of every close-up, each (n, count, 7 or 9) corners."""
    # open-circuit voltage until ignition, then burning voltage; an open pulse has it for its whole delay, a short
    # circuit has none. An equalising pulse of the other polarity follows at once, but not after the last pulse,
    # because the window ends before its pause. If a close-up has fewer pulses, its first one is repeated in front
    last = np.maximum(closeups["count"][:, None] - count + np.arange(count), 0)
    pulses = np.take_along_axis(closeups["pulses"], last, axis=1)
    start, delay, on = (pulses[name].astype(np.float64) for name in ("start_us", "delay_us", "conducting_us"))
    start = start - start[:, :1]
    stop = np.concatenate([start[:, 1:], start[:, -1:] + _last_us(start, delay + on)], axis=1)
    is_open, is_short = pulses["kind"] == OPEN, pulses["kind"] == SHORT
    up = np.where(is_short, 0.0, pulses["open_V"])
    burning = np.where(is_open | is_short, 0.0, closeups["burning_V"][:, None])
    flowing = np.where(is_open, 0.0, np.where(is_short, closeups["short_A"][:, None], closeups["current_A"][:, None]))
    ignition, end, zero = start + delay, start + delay + on, np.zeros_like(start)
    stop = np.maximum(stop, end)
    time = [start, start, ignition, ignition, end, end]
    voltage, current = [zero, up, up, burning, burning], [zero, zero, zero, flowing, flowing]
    if closeups["opposite_V"].any():
        lasts = np.take_along_axis(_opposite_us(closeups), last, axis=1)
        opposite_V, opposite_A = (np.where(lasts > 0.0, closeups[f"opposite_{unit}"][:, None], 0.0) for unit in "VA")
        time += [np.minimum(end + lasts, stop)] * 2
        voltage += [opposite_V, opposite_V]
        current += [opposite_A, opposite_A]
    at_end = [zero, zero]
    return np.stack([*time, stop], -1), np.stack(voltage + at_end, -1), np.stack(current + at_end, -1)


def _last_us(start_us: Floats, busy_us: Floats) -> Floats:
    """Return the duration of every close-up's last pulse, (n, 1), from period or pause, whichever varies less."""
    period_us = np.diff(start_us, axis=1)
    if period_us.shape[1] == 0:
        return busy_us
    pause_us = period_us - busy_us[:, :-1]
    even = np.ptp(period_us, axis=1) <= np.ptp(pause_us, axis=1)
    return np.where(even, period_us[:, -1], busy_us[:, -1] + pause_us[:, -1])[:, None]


def _opposite_us(closeups: NDArray[np.void]) -> Floats:
    """Return the duration of the equalising pulse after every stored pulse, (n, pulses); 0 after the last one."""
    pulses = closeups["pulses"]
    start, delay, on, open_V = (
        pulses[name].astype(np.float64) for name in ("start_us", "delay_us", "conducting_us", "open_V")
    )
    burning_V = closeups["burning_V"].astype(np.float64)[:, None]
    room = np.zeros_like(start)
    room[:, :-1] = np.maximum(np.diff(start, axis=1) - (delay + on)[:, :-1], 0.0)
    bridged = pulses["kind"] == SHORT
    none = bridged | (np.arange(pulses.shape[1]) >= closeups["count"][:, None] - 1)
    integral = np.where(bridged, 0.0, open_V * delay + burning_V * on)
    return pulse_lengths_us(integral, np.where(none, 0.0, room), -closeups["opposite_V"].astype(np.float64))


def _samples(closeup: NDArray[np.void], every_us: float) -> tuple[Floats, ...]:
    """Return the columns of the file for one close-up (1,), as float64 arrays of equal length."""
    count = int(closeup["count"][0])
    pulses = closeup["pulses"][0, :count]
    if count == 0:
        return tuple(np.zeros((6, 0)))
    shown = traces(closeup, count)
    corners = shown[0].shape[-1]
    time, voltage, current = (values[0].ravel() for values in shown)
    at = np.arange(0.0, time[-1], every_us)
    # the last corner at or before a sample: of a vertical edge, its later end
    place = np.searchsorted(time, at, side="right") - 1
    pulse = place // corners
    return (
        np.full(len(at), closeup["t_s"][0]), at + pulses["start_us"][0], voltage[place], current[place],
        pulse.astype(np.float64), pulses["kind"][pulse].astype(np.float64),
    )  # fmt: skip
