"""Passes of a contour: offsets, tab, overlap, the way to and fro, and passes that a program has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from edmsim.errors import InputError
from edmsim.program.passes import PassPlan
from edmsim.program.path import CutPath, WireContour, plan_path

SQUARE = "G21 G90\nG0 X-1.5 Y2\nG41 G1 X0\n{}G40\nM2\n"
ROUND = "Y4\nX4\nY0\nX0\nY2\n"
OFFSETS_MM = (0.25, 0.2, 0.15)


def plan(folder: Path, text: str = SQUARE.format(ROUND), passes: PassPlan | None = None, **settings: Any) -> CutPath:
    file = folder / "a.ngc"
    file.write_text(text)
    return plan_path(file, auto_offset_mm=0.2, passes=passes, **settings)


def of_square(folder: Path, offsets_mm: tuple[float, ...] = OFFSETS_MM, **plan_options: Any) -> WireContour:
    return plan(folder, passes=PassPlan(offsets_mm, **plan_options)).contours[0]


def test_rough_forward_trims_to_and_fro_then_the_tab(tmp_path: Path) -> None:
    """The order of shops: the profile without the tab, to and fro, a stop, the tab with the rough condition first."""
    contour = of_square(tmp_path, tab_mm=1.5)
    told = [(p.number, p.piece, p.reversed, p.stops_before, p.frees) for p in contour.passes]
    assert told == [
        (1, "profile", False, False, False), (2, "profile", True, False, False), (3, "profile", False, False, False),
        (1, "tab", False, True, True), (2, "tab", True, False, False), (3, "tab", False, False, False),
    ]  # fmt: skip
    assert contour.offset_um == 150.0  # that of the last pass
    for before, now in zip(contour.passes, contour.passes[1:], strict=False):
        np.testing.assert_array_equal(before.points_um[-1], now.points_um[0])  # the wire stays threaded


def test_every_pass_keeps_its_offset(tmp_path: Path) -> None:
    contour = of_square(tmp_path)
    edge = shapely.LineString(contour.nominal_mm)
    for one in contour.passes:
        places = shapely.points(one.points_um[one.approach_moves :] * 1e-3)
        assert shapely.distance(edge, places).min() == pytest.approx(one.offset_um * 1e-3, abs=1.5e-3)


def test_the_tab_stays_until_its_own_passes(tmp_path: Path) -> None:
    contour = of_square(tmp_path, tab_mm=1.5)
    around = 16.0
    rough, tab = contour.passes[0], contour.passes[3]
    corners = 3 * np.pi / 2 * 0.25  # three quarters, and the fourth is round about as well
    assert rough.length_mm == pytest.approx(around - 1.5 + corners + np.pi / 2 * 0.25, abs=0.01)
    assert tab.length_mm == pytest.approx(1.5 + 2 * 0.1, abs=0.01)
    trims = [p.length_mm for p in contour.passes if p.piece == "profile"]
    assert trims[0] > trims[1] > trims[2]  # each ends before the round front of the rough pass
    assert contour.passes[5].length_mm > contour.passes[4].length_mm > tab.length_mm


def test_without_a_tab_passes_go_all_round(tmp_path: Path) -> None:
    contour = of_square(tmp_path, tab_mm=0.0)
    assert [(p.number, p.reversed, p.frees) for p in contour.passes] == [
        (1, False, True), (2, True, False), (3, False, False),
    ]  # fmt: skip
    assert all(p.length_mm > 16.0 for p in contour.passes)


def test_one_offset_is_one_pass(tmp_path: Path) -> None:
    path = plan(tmp_path, passes=PassPlan((0.2,)))
    assert path.passes == 1
    assert path.contours[0].passes == ()
    np.testing.assert_array_equal(path.contours[0].points_um, plan(tmp_path).contours[0].points_um)


@pytest.mark.parametrize("offsets_mm", [(0.25, 0.2), (0.25, 0.2, 0.15)])
def test_points_are_on_the_grid_and_within_the_table(tmp_path: Path, offsets_mm: tuple[float, ...]) -> None:
    contour = plan(tmp_path, passes=PassPlan(offsets_mm), grid_um=2).contours[0]
    for way in contour.ways_um:
        assert not (way % 2).any()
        assert way.min() >= 0
        assert way.max() <= 65_000


AGAIN = "G0 X-1.5 Y2\n{} G1 X0 {}\n{}G40\n"


def test_a_program_that_cuts_an_edge_twice_has_passes(tmp_path: Path) -> None:
    """Forward with G41 at D1, back on the same edge with G42 at D2."""
    back = "Y0\nX4\nY4\nX0\nY2\n"
    text = "G21 G90\nD1=0.25\nD2=0.2\n" + AGAIN.format("G41", "D1", ROUND) + AGAIN.format("G42", "D2", back) + "M2\n"
    path = plan(tmp_path, text)
    assert len(path.contours) == 1
    assert [(p.offset_um, p.reversed) for p in path.contours[0].passes] == [(250.0, False), (200.0, True)]
    assert path.contours[0].offset_um == 200.0


def test_the_part_on_the_other_side_is_another_cut(tmp_path: Path) -> None:
    text = "G21 G90\nD1=0.25\nD2=0.2\n" + AGAIN.format("G41", "D1", ROUND) + "G0 X2 Y2\nG42 G1 X0 D2\n" + ROUND
    assert len(plan(tmp_path, text + "G40\nM2\n").contours) == 2


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"offsets_mm": (0.15, 0.2)}, "the offset grows from pass 1 to pass 2, 0.15 to 0.2 mm"),
        ({"offsets_mm": ()}, "1 to 9 passes, not in 0"),
        ({"offsets_mm": (0.2, 0.0)}, "an offset of 0 mm leaves no room for a wire"),
        ({"tab_mm": 16.5}, "the tab of 16.5 mm is longer than the contour, 16.000 mm"),
        ({"tab_mm": 15.9}, "leaves 0.100 mm of the contour to cut"),
        ({"tab_mm": -1.0}, "tab_mm is -1.0"),
        ({"overlap_mm": float("nan")}, "overlap_mm is nan"),
        ({"after_tab": "glue"}, "after_tab is 'glue': the machine can stop before the tab, or cut on"),
    ],
)
def test_what_cannot_be_cut_is_refused_in_one_line(tmp_path: Path, options: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError) as refused:
        of_square(tmp_path, options.pop("offsets_mm", OFFSETS_MM), **options)
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


def test_passes_want_an_edge(tmp_path: Path) -> None:
    text = SQUARE.format(ROUND).replace("G41 ", "")
    with pytest.raises(InputError, match="passes run beside an edge: use G41 or G42"):
        plan(tmp_path, text, passes=PassPlan(OFFSETS_MM))


def test_offsets_of_a_program_may_not_grow(tmp_path: Path) -> None:
    text = "G21 G90\nD1=0.2\nD2=0.25\n" + AGAIN.format("G41", "D1", ROUND) + AGAIN.format("G41", "D2", ROUND) + "M2\n"
    with pytest.raises(InputError, match="the offset grows from pass 1 to pass 2") as refused:
        plan(tmp_path, text)
    assert refused.value.line == 14
