"""Stores of bounded size for a cut of any length: frames of wire and gas, and windows pulse by pulse.

The more is shown, the fewer frames are kept. Close-ups are a thinned run of windows over the whole cut, and all
windows around events. What is kept depends on the windows seen alone, so equal cuts keep equal frames and close-ups.
"""

import math
from bisect import bisect
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.observers import Observer, PlantView, Turn
from edmsim.errors import InputError
from edmsim.files import replacing
from edmsim.geometry import CORNER_DEG, Floats
from edmsim.plant.gap.generator import pulse_lengths_us
from edmsim.plant.kernel.state import ARC, OPEN, PULSE, SHORT, SPARK
from edmsim.snapshots import ArraySnapshots

Bytes = NDArray[np.uint8]  # rows as bytes, (size,) or (n, size)


def bytes_of(rows: NDArray[np.void]) -> Bytes:
    """Look at rows (..., n) as bytes (..., n, size): numpy copies records field by field, twenty times as slowly."""
    return rows.view(np.uint8).reshape(*rows.shape, rows.itemsize)


class Thinned(ArraySnapshots):
    """Every `stride`-th row; the stride doubles whenever the store is full, so equal cuts keep equal rows."""

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
        """Whether the next row's turn has come; if not, it may as well be passed over with `skip`."""
        return self._offered % self.stride == 0

    def skip(self) -> None:
        """Let a row pass whose turn has not come."""
        self._offered += 1

    def offer(self, row: Bytes) -> None:
        """Show one row, its bytes; it is kept if its turn has come."""
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
        """Rows kept, (n,)."""
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


class Frames(ArraySnapshots, Observer):
    """Every `stride`-th window's wire shape and gas, thinned as `Thinned` does."""

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
        """Windows from one kept frame to the next."""
        return self._thinned.stride

    def window(self, turn: Turn, plant: PlantView) -> None:
        """See a window; it is kept if its turn has come."""
        if self._thinned.wants_next:
            place = plant.commanded_um, turn.path_um
            self.offer(turn.time_ns * 1e-9, *place, plant.deflections_um(), plant.coverage())
        else:
            self._thinned.skip()

    def offer(self, *row: object) -> None:
        """Show one window: what `rows` have of it."""
        self._row[0] = row
        self._thinned.offer(bytes_of(self._row)[0])

    @property
    def rows(self) -> NDArray[np.void]:
        """Frames stored, (n,): machine time, guides on the table, place along the path, wire minus guides, gas."""
        return self._thinned.rows


PULSES = 96  # the last pulses of a window, which are what is kept of it
REGULAR = 600  # most close-ups of the run over the whole cut
AROUND = 20  # windows kept before and after an event: half a second on either side at a period of 100 us
BLOCKS = 40  # most events of a kind around which all is kept

NOTHING, RETRACT, TURN = 0, 1, 2
"""Events that are worth all detail: the wire begins to run back; it passes a corner or begins a contour."""


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
    """Return the lengths along a polyline (n, 2) at which it turns by more than `CORNER_DEG`, its begin included."""
    legs = np.diff(points_um.astype(np.float64), axis=0)
    legs = legs[(legs != 0.0).any(axis=1)]
    along = np.cumsum(np.hypot(*legs.T))
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turn = np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi)
    return [0.0, *along[:-1][turn > np.radians(CORNER_DEG)].tolist()]


class Blocks(ArraySnapshots):
    """Rows around events, a block each; if there are too many, every second block goes and they are spaced wider."""

    STATE = ("_lengths", "rows", "_spacing", "_free_from", "_rows_left")

    def __init__(self, kind: np.dtype[np.void]) -> None:
        self._rows = np.zeros((BLOCKS, 2 * AROUND + 1), kind)
        self._bytes = bytes_of(self._rows)
        self._lengths: list[int] = []
        self._spacing = 2 * AROUND + 1
        self._free_from = 0
        self._rows_left = 0

    def offer(self, number: int, row: Bytes, before: Bytes, happened: bool) -> None:
        """Show row `number`, its bytes; `before` are the rows before it, `happened` says whether it has an event."""
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


class Closeups(ArraySnapshots, Observer):
    """Windows of a cut kept in full, with the wall of one slice."""

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
        """Have the plant keep its pulses."""
        plant.watch_pulses()

    def leg(self, points_um: NDArray[np.int64], start_um: float) -> None:
        """Note where along the path the leg turns."""
        self._turns_um, self._turns_passed = [start_um + turn for turn in turns_um(points_um)], 0

    def window(self, turn: Turn, plant: PlantView) -> None:
        """Keep a window, and say what happened in it."""
        row, timing = self.row, plant.timing
        row["t_s"], row["guides_um"], row["path_um"] = turn.time_ns * 1e-9, plant.commanded_um, turn.path_um
        row["burning_V"], row["current_A"], row["short_A"] = timing.burning_V, timing.current_A, timing.short_A
        opposite = turn.opposite
        row["opposite_V"] = 0.0 if opposite is None else opposite.voltage_V
        row["opposite_A"] = 0.0 if opposite is None else opposite.current_A
        row["wire_um"], row["walls_um"] = plant.walls_um(self.slice_index)
        row["deflection_um"], row["coverage"] = plant.deflections_um(), plant.coverage()
        self._fill_pulses(plant.last_pulses())
        passed = bisect(self._turns_um, turn.path_um)
        runs_back = turn.feed_um_s < 0 <= self._feed_um_s
        event = TURN if passed != self._turns_passed else RETRACT if runs_back else NOTHING
        self._turns_passed, self._feed_um_s = passed, turn.feed_um_s
        self.keep(event)

    @property
    def row(self) -> np.void:
        """The row to fill with the window just over, before it is `keep`-ed."""
        row: np.void = self._last[self._windows % len(self._last)]
        return row

    def _fill_pulses(self, pulses: NDArray[np.void]) -> None:
        """Fill the last pulses of the window just over (rows of `PULSE`) into `row`."""
        last = pulses[-PULSES:]
        at, begin = self._windows % len(self._last), self._pulses_at
        self._bytes[at, begin : begin + last.nbytes] = last.view(np.uint8)
        self._last[at]["count"] = len(last)

    def keep(self, event: int = NOTHING) -> None:
        """Take the filled `row` in; `event` is what happened in its window."""
        at = self._windows % len(self._last)
        row = self._bytes[at]
        self._run.offer(row)
        before = self._before(at) if event != NOTHING else self._bytes[:0]
        for kind, blocks in self._blocks.items():
            blocks.offer(self._windows, row, before, kind == event)
        self._windows += 1

    def _before(self, at: int) -> Bytes:
        """Return the rows before the one at a place of the ring, oldest first."""
        older = self._bytes[at + 1 :] if self._windows >= len(self._last) else self._bytes[:0]
        return np.concatenate([older, self._bytes[:at]])

    @property
    def stride(self) -> int:
        """Windows from one close-up of the run over the whole cut to the next."""
        return self._run.stride

    def table(self) -> NDArray[np.void]:
        """Return all close-ups in order of time, (n,) rows of `row_type`: run, events, and the cut's last windows."""
        last = self._last[self._last["t_s"] > 0.0]
        everything = np.concatenate([self._run.rows, *(blocks.rows for blocks in self._blocks.values()), last])
        _, first = np.unique(everything["t_s"], return_index=True)
        return np.asarray(everything[first])


# Gap voltage and current of the pulses that close-ups keep: corners of the traces, and samples of them in a file.

_KINDS = {OPEN: "open", SPARK: "spark", ARC: "arc", SHORT: "short"}
_TICK_US = 1e-3  # the plant's clock
_TOGETHER = 32  # windows written at once (ours: some half a million samples, a few MB)


def traces(closeups: NDArray[np.void], count: int) -> tuple[Floats, Floats, Floats]:
    """Return time, voltage and current of the last pulses of every close-up, each (n, count, 7 or 9) corners."""
    # voltage is open until ignition, then burns; a pulse without ignition shows it for as long as it was waited, a
    # short circuit none. An equalising pulse follows at once, of the other polarity; the last pulse shows none, as it
    # ends before its pause. Where a close-up has fewer pulses, its first one is repeated in front
    last = np.maximum(closeups["count"][:, None] - count + np.arange(count), 0)
    pulses = np.take_along_axis(closeups["pulses"], last, axis=1)
    start, delay, on = (pulses[name].astype(np.float64) for name in ("start_us", "delay_us", "conducting_us"))
    start = start - start[:, :1]
    step = np.diff(start, axis=1)
    stop = start + np.concatenate([step, np.maximum(step[:, -1:], (delay + on)[:, -1:])], axis=1)
    is_open, is_short = pulses["kind"] == OPEN, pulses["kind"] == SHORT
    up = np.where(is_short, 0.0, pulses["open_V"])
    burning = np.where(is_open | is_short, 0.0, closeups["burning_V"][:, None])
    flowing = np.where(is_open, 0.0, np.where(is_short, closeups["short_A"][:, None], closeups["current_A"][:, None]))
    ignition, end, nought = start + delay, start + delay + on, np.zeros_like(start)
    stop = np.maximum(stop, end)
    if not closeups["opposite_V"].any():
        time = np.stack([start, start, ignition, ignition, end, end, stop], axis=-1)
        voltage = np.stack([nought, up, up, burning, burning, nought, nought], axis=-1)
        current = np.stack([nought, nought, nought, flowing, flowing, nought, nought], axis=-1)
        return time, voltage, current
    lasts = np.take_along_axis(_opposite_us(closeups), last, axis=1)
    back, has_opposite = np.minimum(end + lasts, stop), lasts > 0.0
    opposite_V, opposite_A = (np.where(has_opposite, closeups[f"opposite_{unit}"][:, None], 0.0) for unit in "VA")
    time = np.stack([start, start, ignition, ignition, end, end, back, back, stop], axis=-1)
    voltage = np.stack([nought, up, up, burning, burning, opposite_V, opposite_V, nought, nought], axis=-1)
    current = np.stack([nought, nought, nought, flowing, flowing, opposite_A, opposite_A, nought, nought], axis=-1)
    return time, voltage, current


def _opposite_us(closeups: NDArray[np.void]) -> Floats:
    """Length of the equalising pulse behind every pulse kept, (n, pulses); 0 behind the last, which has no pause."""
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


def write_traces(closeups: NDArray[np.void], file: str | Path, every_us: float) -> None:
    """Write samples of the traces to a Parquet file; see `edmsim.CutResult.write_traces` for its columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not _TICK_US <= every_us < math.inf:
        raise InputError(f"every_us is {every_us:g}: the time between samples must be {_TICK_US:g} us or more")
    kind = pa.dictionary(pa.int8(), pa.string())
    schema = pa.schema([
        ("window_t_s", pa.float64()), ("time_us", pa.float64()), ("voltage_V", pa.float32()),
        ("current_A", pa.float32()), ("pulse", pa.int16()), ("kind", kind),
    ])  # fmt: skip
    names = pa.array([_KINDS[number] for number in sorted(_KINDS)])
    with replacing(file) as partial, pq.ParquetWriter(partial, schema, compression="zstd") as writer:
        for first in range(0, len(closeups), _TOGETHER):
            last = min(first + _TOGETHER, len(closeups))
            some = [_samples(closeups[i : i + 1], every_us) for i in range(first, last)]
            *columns, kinds = (np.concatenate(parts) for parts in zip(*some, strict=True))
            arrays = [pa.array(c, field.type) for c, field in zip(columns, schema, strict=False)]
            coded = pa.DictionaryArray.from_arrays(pa.array(kinds.astype(np.int8)), names)
            writer.write_table(pa.Table.from_arrays([*arrays, coded], schema=schema))


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
    # the last corner at or before a sample: where an edge is upright, its later end
    place = np.searchsorted(time, at, side="right") - 1
    pulse = place // corners
    return (
        np.full(len(at), closeup["t_s"][0]), at + pulses["start_us"][0], voltage[place], current[place],
        pulse.astype(np.float64), pulses["kind"][pulse].astype(np.float64),
    )  # fmt: skip
