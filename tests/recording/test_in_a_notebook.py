"""What a notebook shows of a cut: a few lines, a card with table and picture, figures that show by themselves."""

from __future__ import annotations

import base64
import io
import re
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import edmsim
from edmsim.errors import InputError
from edmsim.program.path import CutPath, WireContour

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def result(cut: SimpleNamespace) -> edmsim.CutResult:
    """The made-up cut as `edmsim.cut` returns one."""
    points = np.array([[0, 0], [3000, 0], [3000, 4000]])
    contour = WireContour(points, 1, points / 1e3, closed=False, part_side="left")
    path = CutPath((contour,), cut.scene.stock_mm, 0.5, 150.0, (20.0, 20.0), (), "rectangle.ngc")
    field = None
    return edmsim.CutResult(
        cut.report, cut.windows, path, field, cut.frames, cut.scene, cut.closeups, cut.machine  # type: ignore[arg-type]
    )


def test_what_is_worked_with_is_said_in_a_few_lines(result: edmsim.CutResult) -> None:
    plant = edmsim.Plant(result.machine, resolution="fast")
    for shown in (result, result.machine, plant, result.path, result.scene):
        lines = repr(shown).splitlines()
        assert len(lines) <= 6
        assert max(map(len, lines)) < 240
    assert repr(result).startswith("<CutResult of rectangle.ngc: finished\n")
    assert "10.2 µm max, 2.1 µm rms" in repr(result)
    assert "height_mm=20.0" in repr(result.machine)
    assert "5 slices x 24 rays" in repr(plant)
    assert "7.000 mm in 2 moves" in repr(result.path)


def test_a_result_shows_its_table_and_its_picture(result: edmsim.CutResult) -> None:
    html = result._repr_html_()
    assert "<b>rectangle.ngc: finished</b>" in html
    assert "10.2 µm max, 2.1 µm rms" in html
    assert "note: made up" in html
    (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    assert Image.open(io.BytesIO(base64.b64decode(picture))).width == 800
    assert len(html) < 400_000  # a notebook keeps it


@pytest.mark.parametrize("name", ["profile", "corner", "kerf-section"])
def test_a_figure_shows_by_itself(result: edmsim.CutResult, name: str) -> None:
    figure = result.plot() if name == "profile" else result.plot(name)
    assert figure._repr_png_().startswith(PNG)  # type: ignore[attr-defined]


def test_a_figure_that_is_not_there_is_told(result: edmsim.CutResult) -> None:
    with pytest.raises(InputError, match="no figure 'kerf'; there are: profile, profile-error, .*wire-spectrum$"):
        result.plot("kerf")
