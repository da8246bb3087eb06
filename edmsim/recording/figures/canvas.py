"""The figure that all others are drawn on: it needs neither pyplot nor a display, and a notebook shows it."""

from __future__ import annotations

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A figure that shows by itself in a notebook, as else only pyplot's do; pyplot's global state is not touched."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        held = io.BytesIO()
        self.savefig(held, format="png", metadata={"Software": "edmsim"})
        return held.getvalue()
