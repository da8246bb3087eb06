"""Path along a straight or other open edge in passes, for cuts from which settings and offsets are found."""

from collections.abc import Sequence

import numpy as np

from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.program.offset import OffsetOutline, offset_edge
from edmsim.program.outline import Outline
from edmsim.program.passes import PassPlan, on_grid, stretches_of
from edmsim.program.path import STOCK_MARGIN_MM, CutPath, WireContour

_HOLE_MM, _LEAD_MM = 0.3, 0.5  # radius of the start hole, and its distance from the cut (ours)


def straight_path(
    offsets_mm: Sequence[float], length_mm: float, machine: Machine, edge_mm: Floats | None = None
) -> CutPath:
    """Return the path in passes of a straight or other open edge along +x, from a start hole, with the part below."""
    middle = np.array(machine.base.table.centre_um) * 1e-3 - (length_mm / 2, 0.0)
    edge = np.array([[0.0, 0.0], [length_mm, 0.0]]) if edge_mm is None else edge_mm
    edge, count = edge + middle, len(edge) - 1
    elements = tuple(range(1, count + 1))
    outline = Outline(edge, (0,) * count, False, "left", "right", np.empty((0, 2)), elements=elements)
    past_mm = [None, *[offsets_mm[0]] * (len(offsets_mm) - 1)]  # trims go straight past outer corners
    paths_mm = [offset_edge(edge, "left", mm, False, past) for mm, past in zip(offsets_mm, past_mm, strict=True)]
    legs = [OffsetOutline(outline, path, edge, mm) for path, mm in zip(paths_mm, offsets_mm, strict=True)]
    stretches = stretches_of(legs, PassPlan(tuple(offsets_mm)))
    lead = stretches[0].points[:1] - (_LEAD_MM, 0.0)
    passes = on_grid(stretches, lead, 1)
    points = np.round(np.concatenate([lead, legs[-1].path]) * 1e3).astype(np.int64)
    contour = WireContour(
        points, 1, edge, False, "right", elements=tuple((k, 0) for k in elements), offset_um=offsets_mm[-1] * 1e3,
        passes=passes,
    )
    every = np.concatenate([points * 1e-3, edge])
    low, high = every.min(axis=0) - STOCK_MARGIN_MM, every.max(axis=0) + STOCK_MARGIN_MM
    stock = float(low[0]), float(low[1]), float(high[0]), float(high[1])
    return CutPath((contour,), stock, _HOLE_MM, (0.0, 0.0), (), "straight cut")
