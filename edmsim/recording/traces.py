"""Gap voltage and current of the pulses that close-ups keep: corners of the traces, and samples of them in a file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.files import replacing
from edmsim.plant.gap.equalising import pulse_lengths_us
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

_KINDS = {OPEN: "open", SPARK: "spark", ARC: "arc", SHORT: "short"}
_TOGETHER = 32  # windows written at once (ours: some half a million samples, a few MB)


def traces(
    closeups: NDArray[np.void], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
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


def _opposite_us(closeups: NDArray[np.void]) -> NDArray[np.float64]:
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

    if not 0 < every_us < math.inf:
        raise InputError(f"every_us is {every_us:g}: the time between samples must be above 0 us")
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


def _samples(closeup: NDArray[np.void], every_us: float) -> tuple[NDArray[np.float64], ...]:
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
