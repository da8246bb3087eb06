"""The contour of a cut as a file for other programs: DXF, CSV or SVG, in the program's coordinates."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.files import make_writable, replacing
from edmsim.recording.face_file import cut_faces, is_whole
from edmsim.recording.scene import Scene

_COLOURS = {"CUT": (1, "#d55e00"), "NOMINAL": (7, "#1f2933")}
"""Of both layers: index of AutoCAD, and for SVG."""


def write_contour(scene: Scene, file: str | Path, height_mm: float | None = None) -> None:
    """Write the cut edges as ``.dxf``, ``.csv`` or ``.svg``, and the edges as drawn, in mm of the program."""
    # at a height over the workpiece's lower face only the part's wall, between the slices next to it; by
    # default all edges of the kerf at mid height
    writers = {".dxf": _write_dxf, ".csv": _write_csv, ".svg": _write_svg}
    target = Path(file)
    if target.suffix.lower() not in writers:
        raise InputError(f"a contour is written as {' '.join(writers)}", target)
    scene = scene.in_program()
    if height_mm is None:
        edges = scene.cut_edges_mm[scene.middle_slice()] if scene.cut_edges_mm else ()
        layers = {
            "CUT": [line for line in edges if is_whole(line, scene)],
            "NOMINAL": [edge.nominal_mm for edge in scene.maps],
        }
    else:
        layers = _at_height(scene, height_mm, target)
    make_writable(target.parent)
    with replacing(target) as partial:
        writers[target.suffix.lower()](layers, partial)


def _at_height(scene: Scene, height_mm: float, target: Path) -> dict[str, list[NDArray[np.float64]]]:
    if not 0 <= height_mm <= scene.height_mm:
        raise InputError(
            f"there is no contour {height_mm:g} mm high: the workpiece has 0 to {scene.height_mm:g} mm", target
        )
    share = height_mm / scene.height_mm
    walls = [(1 - share) * below + share * above for below, above in scene.walls_mm]
    return {
        "CUT": [face.at(height_mm) for face in cut_faces(scene)],
        "NOMINAL": walls or [edge.nominal_mm for edge in scene.maps],
    }


def _is_closed(line: NDArray[np.float64]) -> bool:
    return len(line) > 2 and bool(np.allclose(line[0], line[-1], atol=1e-6))


def _write_dxf(layers: Mapping[str, Sequence[NDArray[np.float64]]], file: Path) -> None:
    from ezdxf.filemanagement import new

    document = new("R2010", units=4)
    for layer, lines in layers.items():
        document.layers.add(layer, color=_COLOURS[layer][0])
        for line in lines:
            closed = _is_closed(line)
            points = (line[:-1] if closed else line).tolist()
            document.modelspace().add_lwpolyline(points, close=closed, dxfattribs={"layer": layer})
    document.saveas(file)


def _write_csv(layers: Mapping[str, Sequence[NDArray[np.float64]]], file: Path) -> None:
    with file.open("w", newline="", encoding="utf-8") as opened:
        rows = csv.writer(opened)
        rows.writerow(["layer", "line", "x_mm", "y_mm"])
        for layer, lines in layers.items():
            for number, line in enumerate(lines, 1):
                rows.writerows([layer, number, f"{x:.5f}", f"{y:.5f}"] for x, y in line)


def _write_svg(layers: Mapping[str, Sequence[NDArray[np.float64]]], file: Path) -> None:
    points = np.concatenate([line for lines in layers.values() for line in lines])
    (x0, y0), (x1, y1) = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    width, height = x1 - x0, y1 - y0
    text = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="{x0:.5f} {-y1:.5f} {width:.5f} {height:.5f}">'
    ]
    for layer, lines in layers.items():
        style = f'class="{layer.lower()}" fill="none" stroke="{_COLOURS[layer][1]}" stroke-width="0.01"'
        for line in lines:
            way = " L".join(f"{x:.5f},{-y:.5f}" for x, y in line)  # Y of a picture points down
            text.append(f'<path {style} d="M{way}{" Z" if _is_closed(line) else ""}"/>')
    file.write_text("\n".join([*text, "</svg>\n"]), encoding="utf-8")
