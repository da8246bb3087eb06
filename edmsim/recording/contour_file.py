"""The contour of a cut as a file for other programs: DXF, CSV or SVG, in the program's coordinates."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.files import make_writable, replacing
from edmsim.recording.scene import Scene

SPECK_SHARE = 0.01
"""Share of the wire's cross-section below which a closed edge is a speck (ours: a crater or two)."""

_COLOURS = {"CUT": (1, "#d55e00"), "NOMINAL": (7, "#1f2933")}
"""Of both layers: index of AutoCAD, and for SVG."""


def write_contour(scene: Scene, file: str | Path) -> None:
    """Write the cut edges at mid height, and the edges as drawn, in mm of the program or drawing.

    Parameters
    ----------
    scene : Scene
    file : path
        ``.dxf``: polylines on the layers ``CUT`` and ``NOMINAL``, unit mm. ``.csv``: columns ``layer``, ``line`` (a
        number from 1), ``x_mm``, ``y_mm``. ``.svg``: paths of the classes ``cut`` and ``nominal``, 1 mm a unit.

    Raises
    ------
    InputError
        Another suffix, or the file cannot be written.
    """
    writers = {".dxf": _write_dxf, ".csv": _write_csv, ".svg": _write_svg}
    target = Path(file)
    if target.suffix.lower() not in writers:
        raise InputError(f"a contour is written as {' '.join(writers)}", target)
    scene = scene.in_program()
    least_mm2 = SPECK_SHARE * math.pi / 4 * (scene.wire_diameter_um * 1e-3) ** 2
    edges = scene.cut_edges_mm[scene.middle_slice()] if scene.cut_edges_mm else ()
    layers = {
        "CUT": [line for line in edges if _area_mm2(line) >= least_mm2],
        "NOMINAL": [edge.nominal_mm for edge in scene.maps],
    }
    make_writable(target.parent)
    with replacing(target) as partial:
        writers[target.suffix.lower()](layers, partial)


def _area_mm2(line: NDArray[np.float64]) -> float:
    (x, y) = (line - line[0]).T
    return abs(float(x[:-1] @ y[1:] - x[1:] @ y[:-1])) / 2


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
