"""Steps of an environment in the recording: what was commanded, and what it earned and cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.recording.figures import palette
from edmsim.recording.rerun.blueprint import Plot, Series

RETURN, COST = "return", "cost"  # where what was earned and what it cost stand in a recording
TOTAL = "total"  # curve of their sums from the beginning on
_COLOURS = (
    palette.SKY, palette.ORANGE, palette.GREEN, palette.VERMILION, palette.PURPLE, palette.MUTED, palette.BLUE,
    palette.GAS,
)  # fmt: skip


class Steps(NamedTuple):
    """What an environment adds to the recording of its cut, step by step."""

    plots: tuple[Plot, ...]  # views, whose curves are logged under their origins
    values: Mapping[str, NDArray[np.float64]]  # of every curve, by ``origin/entity``, its values (n,)
    t_s: NDArray[np.float64]  # t_s, path_um: machine time and place along the path at the end of every step
    path_um: NDArray[np.float64]
    notes: Sequence[str]  # how the cut was thinned, for the text about the recording


def steps_of(
    groups: Sequence[tuple[str, str, Sequence[str], NDArray[np.float64]]], t_s: NDArray[np.float64],
    path_um: NDArray[np.float64], notes: Sequence[str],
) -> Steps:
    """Lay out curves in views: of each its origin, title with unit, names of curves, and values (n, curves)."""
    # NaN is not drawn, and curves that are 0 throughout are left out
    plots, values = [], {}
    for origin, title, names, columns in groups:
        shown = [
            (name, column) for name, column in zip(names, columns.T, strict=True)
            if name == TOTAL or np.any(np.nan_to_num(column) != 0.0)
        ]  # fmt: skip
        if not shown:
            continue
        colours = (_COLOURS[k % len(_COLOURS)] for k in range(len(shown)))
        curves = [Series(name, name.replace("_", " "), c) for (name, _), c in zip(shown, colours, strict=True)]
        plots.append(Plot(origin, title, tuple(curves)))
        values.update({f"{origin}/{name}": column for name, column in shown})
    return Steps(tuple(plots), values, t_s, path_um, notes)
