"""``part.npz``: the drawing of a cut, so that its figures can be made again from the folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.files import read_arrays, replacing
from edmsim.metrology.shares import SHARES
from edmsim.recording.scene import ErrorMap, Polylines, Scene, SceneCorner, Terrace

VERSION = 3
"""Of the file's layout."""


def write_scene(scene: Scene, file: str | Path) -> None:
    """Write a scene; a file of that name is replaced whole or not at all."""
    told = {
        "version": VERSION, "stock_mm": scene.stock_mm, "height_mm": scene.height_mm,
        "guides_z_mm": scene.guides_z_mm, "wire_diameter_um": scene.wire_diameter_um, "stop_mm": scene.stop_mm,
        "origin_mm": scene.origin_mm,
        "cut": scene.cut, "part_sides": [edge.part_side for edge in scene.maps],
        "terrace_heights_mm": [terrace.height_mm for terrace in scene.terraces],
    }
    corners = [(c.x_mm, c.y_mm, c.turn_deg, c.error_um) for c in scene.corners]
    arrays = {
        **_flat("nominal", [[edge.nominal_mm] for edge in scene.maps]),
        **_flat("measured", [[_columns(edge)] for edge in scene.maps]),
        **_flat("edges", scene.cut_edges_mm),
        **_flat("terraces", [terrace.outlines_mm for terrace in scene.terraces]),
        "corners": np.reshape(np.array(corners, float), (-1, 4)),
        "starts_mm": scene.starts_mm, "holes_mm": scene.holes_mm,
        **{
            f"unreachable.{number}": edge.unreachable_um
            for number, edge in enumerate(scene.maps) if edge.unreachable_um is not None
        },
        "told": np.frombuffer(json.dumps(told).encode(), np.uint8),
    }
    with replacing(file) as partial, partial.open("wb") as opened:
        np.savez_compressed(opened, allow_pickle=False, **arrays)


def _columns(edge: ErrorMap) -> NDArray[np.float64]:
    """Places, error and what made it, side by side; contours that were not split have the same columns."""
    unknown = np.full((len(SHARES), len(edge.points_mm)), np.nan)
    return np.column_stack([edge.points_mm, edge.error_um, *(unknown if edge.shares_um is None else edge.shares_um)])


def read_scene(file: str | Path) -> Scene:
    """Read a ``part.npz``.

    Raises
    ------
    InputError
        If the file is missing, damaged, or of another layout.
    """
    try:
        arrays = read_arrays(Path(file).read_bytes())
        told = json.loads(arrays["told"].tobytes())
        if told["version"] != VERSION:
            raise InputError(f"written in layout {told['version']}, layout {VERSION} is needed: cut again", file)
        return _scene(arrays, told)
    except FileNotFoundError:
        raise InputError("no such file, a part.npz written by a cut is needed", file) from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise InputError(f"damaged, a part.npz written by a cut is needed ({error})", file) from None


def _scene(arrays: Mapping[str, NDArray[Any]], told: Mapping[str, Any]) -> Scene:
    measured = [lines[0] for lines in _groups(arrays, "measured")]
    nominal = [lines[0] for lines in _groups(arrays, "nominal")]
    return Scene(
        maps=tuple(
            ErrorMap(
                line, side, rows[:, :2], rows[:, 2], rows[:, 3:].T if np.isfinite(rows[:, 3:]).any() else None,
                arrays.get(f"unreachable.{number}"),  # earlier files have none
            )
            for number, (line, side, rows) in enumerate(zip(nominal, told["part_sides"], measured, strict=True))
        ),
        cut_edges_mm=_groups(arrays, "edges"),
        corners=tuple(SceneCorner(*(float(v) for v in row)) for row in arrays["corners"]),
        starts_mm=arrays["starts_mm"],
        stock_mm=tuple(told["stock_mm"]),
        height_mm=told["height_mm"],
        guides_z_mm=tuple(told["guides_z_mm"]),
        wire_diameter_um=told["wire_diameter_um"],
        stop_mm=None if told["stop_mm"] is None else tuple(told["stop_mm"]),
        terraces=tuple(
            Terrace(lines, height)
            for lines, height in zip(_groups(arrays, "terraces"), told["terrace_heights_mm"], strict=True)
        ),
        holes_mm=arrays["holes_mm"].reshape(-1, 3),
        cut=told.get("cut"),
        origin_mm=None if told.get("origin_mm") is None else tuple(told["origin_mm"]),  # earlier files have none
    )


def _flat(name: str, groups: Sequence[Sequence[NDArray[np.float64]]]) -> dict[str, NDArray[Any]]:
    """Groups of lines as three arrays: all points, points of each line, lines of each group."""
    lines = [line for group in groups for line in group]
    return {
        f"{name}.points": np.concatenate(lines) if lines else np.zeros((0, 2)),
        f"{name}.lengths": np.array([len(line) for line in lines], np.int64),
        f"{name}.groups": np.array([len(group) for group in groups], np.int64),
    }


def _groups(arrays: Mapping[str, NDArray[Any]], name: str) -> tuple[Polylines, ...]:
    points, lengths, groups = (arrays[f"{name}.{part}"] for part in ("points", "lengths", "groups"))
    counts = np.concatenate([lengths, groups])
    if counts.dtype.kind != "i" or (counts < 0).any() or lengths.sum() != len(points) or groups.sum() != len(lengths):
        raise ValueError(f"the lines of {name} do not add up")
    lines = iter(np.split(points, np.cumsum(lengths)[:-1]) if len(lengths) else [])
    return tuple(tuple(next(lines) for _ in range(count)) for count in groups)
