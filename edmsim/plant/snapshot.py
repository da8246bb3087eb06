"""Checks of a plant's snapshot before it is loaded, because compiled code has no bounds checks."""

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.vectors import GAPS
from edmsim.errors import InputError
from edmsim.machine.machine import Machine, own_mjcf_text
from edmsim.plant.kernel.state import BARE, ArraySizes
from edmsim.plant.workpiece.kerf_field import FULL

_Snapshot = Mapping[str, NDArray[Any]]

_MOST = 1 << 62  # limit of counts and times (ns): 100 years
_ROUNDED = 1e-9  # rounding of a mean of heights (ours: some times 1e-16)

_STATED = {"name", "wire_name", "material_name", "generator_name", "t_on_us", "t_period_us"}
"""Fields of a set-up that change with the pulse setting, which is in the snapshot, or that are only names."""


def digest_of(machine: Machine, drives: Mapping[str, str]) -> NDArray[np.uint8]:
    """Return a digest of a plant's set-up and the names of its drives."""
    said = machine.model_dump_json(exclude=_STATED) + own_mjcf_text(machine.base.model) + repr(sorted(drives.items()))
    return np.frombuffer(hashlib.sha256(said.encode()).digest(), np.uint8)


def check_snapshot(state: _Snapshot, like: _Snapshot, sizes: ArraySizes) -> None:
    """Refuse a snapshot of another set-up, or with missing arrays, other shapes than `like`, or invalid indices."""
    if "set_up" in state and not np.array_equal(state["set_up"], like["set_up"]):
        raise InputError("this is a snapshot of another set-up: restore it in a plant with the same machine, "
                         "material, wire, generator, drives and operator's choices")
    for name, own in like.items():
        stored = state.get(name)
        rows = slice(1, None) if name in ("field.tiles", "field.gone") else slice(None)
        if not isinstance(stored, np.ndarray) or stored.dtype != own.dtype or stored.shape[rows] != own.shape[rows]:
            raise InputError(f"this is not a snapshot of this plant: its {name} is missing or of another kind")
        if not _all_numbers(stored):
            raise InputError(f"the snapshot's {name} holds something that is not a number")
    _check_places(state, sizes)
    _check_metal(state)


def _all_numbers(array: NDArray[Any]) -> bool:
    """Return whether all floats are finite; in records also infinite, as a switch that never opens is."""
    kinds = array.dtype.fields
    if kinds is not None:
        return not any(np.isnan(array[name]).any() for name in kinds if kinds[name][0].base.kind == "f")
    return array.dtype.kind != "f" or bool(np.isfinite(array).all())


def _check_places(state: _Snapshot, sizes: ArraySizes) -> None:
    """Refuse indices beyond arrays, and invalid counts."""
    scalars = state["state"][0]
    counts = "time_ns", "pulses", "traced_pulses", "carved_pulses", "traces"
    within = {
        "last_slice": (scalars["last_slice"], sizes.slices), "last_ray": (scalars["last_ray"], sizes.rays),
        "broken_slice": (scalars["broken_slice"], sizes.slices), "broken": (scalars["broken"], BARE + 1),
        "first": (state["first"], sizes.rays), "blocks": (state["blocks"], sizes.places // GAPS + 1),
        "unbroken": (state["unbroken"], sizes.rays + 1),
        **{name: (scalars[name], _MOST) for name in counts},
    }  # fmt: skip
    for name, (value, count) in within.items():
        if np.any(value < 0) or np.any(value >= count):
            raise InputError(f"the snapshot's {name} is not within 0..{count - 1}")


def _check_metal(state: _Snapshot) -> None:
    """Refuse impossible heights of metal, and an index of the kerf field that is out of range or not unique."""
    for name in ("ray_metal", "metal"):
        if not np.all((state[name] >= 0.5 - _ROUNDED) & (state[name] <= 1.5 + _ROUNDED)):
            raise InputError(f"the snapshot's {name} is not within 0.5..1.5")
    tiles, index = state["field.tiles"], state["field.index"]
    if not np.array_equal(np.sort(index[index != -1]), np.arange(len(tiles))):
        raise InputError("the snapshot's kerf field is damaged: its index and its tiles do not fit")
    if tiles.size and int(tiles.max()) > FULL:
        raise InputError(f"the snapshot's kerf field is damaged: a cell holds more than {FULL} parts")
