"""Pieces of metal that nothing holds any more: cut all round, in every slice."""

from __future__ import annotations

import numpy as np
import shapely

from edmsim.metrology.edges import contour
from edmsim.plant.workpiece.kerf_field import KerfField

RIM_CELLS = 1.5
"""How far beyond its outline a loose piece is taken, in cells: partly filled cells of its rim belong to it (ours)."""


def loose_pieces(field: KerfField, least_mm2: float) -> list[shapely.Polygon]:
    """Return the pieces of `least_mm2` that are cut all round in every slice that has them, in um on the table."""
    holes = shapely.union_all([shapely.Point(x, y).buffer(r) for x, y, r in field.stock.holes_um])
    found: shapely.Geometry | None = None
    for number in range(field.n_slices):
        cut_um = shapely.transform(contour(field, number), lambda mm: mm * 1e3).union(holes)
        islands = [
            shapely.Polygon(ring)
            for part in shapely.get_parts(cut_um) if isinstance(part, shapely.Polygon)
            for ring in part.interiors
        ]  # fmt: skip
        metal = shapely.union_all([island for island in islands if island.area >= least_mm2 * 1e6])
        if field.relief is not None:  # what has no metal at this height holds nothing
            metal = metal.union(field.relief.voids_um[number])
        found = metal if found is None else found.intersection(metal)
    pieces = [] if found is None else [p for p in shapely.get_parts(found) if isinstance(p, shapely.Polygon)]
    gone = shapely.union_all(field.gone)
    rim = RIM_CELLS * field.cell_um
    return [
        shapely.Polygon(piece.exterior).buffer(rim)
        for piece in pieces
        if piece.area >= least_mm2 * 1e6 and not gone.contains(piece.representative_point())
    ]


def lever_mm(piece: shapely.Polygon, last_um: tuple[float, float]) -> float:
    """Return how far the piece's centre is from where it was held last: what it would tip about."""
    x, y = piece.centroid.x, piece.centroid.y
    return float(np.hypot(x - last_um[0], y - last_um[1])) * 1e-3
