"""Checkpoints: save an interrupted cut in its folder, and resume it bit for bit."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from edmsim.cosim.simulation import Simulation
from edmsim.errors import InputError
from edmsim.files import read_arrays, replacing

NAME = "checkpoint.npz"  # file in the output folder; gone when the results are there
FORMAT = 12  # raised when what a checkpoint holds changes: one of another format is refused


def save(simulation: Simulation, folder: Path, settings: Mapping[str, Any], wall_time_s: float) -> None:
    """Write a checkpoint, replacing the last one whole or not at all."""
    arrays, values = simulation.snapshot()
    text = json.dumps({"format": FORMAT, "settings": dict(settings), "values": values, "wall_time_s": wall_time_s})
    with replacing(folder / NAME) as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, __json__=np.frombuffer(text.encode(), np.uint8), **arrays)


def refuse_missing(folder: Path | None) -> None:
    """Raise `InputError` where there is no interrupted cut to resume."""
    if folder is None:
        raise InputError("to resume a cut, name its folder")
    if not (folder / NAME).exists():
        raise InputError("there is no interrupted cut to resume in this folder", folder)


def load(simulation: Simulation, folder: Path, settings: Mapping[str, Any]) -> float:
    """Take up the cut of a folder's checkpoint; returns the wall time spent so far.

    Raises `InputError` if it is damaged or of another version, or belongs to a cut with other settings.
    """
    file = folder / NAME
    try:
        arrays = read_arrays(file.read_bytes())
        saved = json.loads(arrays.pop("__json__").tobytes())
        if saved.get("format") != FORMAT:
            raise InputError("another version of edmsim wrote the checkpoint; cut again without --resume", file)
        _compare(saved["settings"], settings, file)
        try:
            simulation.restore(arrays, saved["values"])
        except InputError as error:
            raise ValueError(error.reason) from None
        return float(saved["wall_time_s"])
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise InputError(f"the checkpoint is damaged ({error}); cut again without --resume", file) from None


def _compare(stored: Mapping[str, Any], expected: Mapping[str, Any], file: Path) -> None:
    # digests last: a setting by name says more
    for name in sorted(stored.keys() | expected.keys(), key=lambda name: (name.endswith("sha256"), name)):
        if stored.get(name) == expected.get(name):
            continue
        if name.endswith("_sha256"):
            what = name.removesuffix("_sha256").replace("_", " ")
            raise InputError(f"{what}: not as in the interrupted cut; undo the change, or use --overwrite", file)
        raise InputError(
            f"the interrupted cut was made with {name} {stored.get(name)!r}, not {expected.get(name)!r}", file
        )
