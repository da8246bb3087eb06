"""Programs of FreeCAD's post-processor for wire EDM: one contour is read with all its switches."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program.gcode_outlines import read_gcode


@dataclass(frozen=True)
class Switches:
    """Options of the post-processor; positions and radii are multiples of its last decimal place."""

    header: bool
    comments: bool
    comment_sign: str
    space: str
    line_end: str
    newline: str
    numbers: bool
    scale: int
    places: int
    digits: int
    inches: bool
    modal: bool
    rapids: bool
    units: bool
    relative: bool
    two_digits: bool
    signs: bool

    @property
    def per_unit(self):
        """Number of grid steps per unit: steps of 0.001 mm or 0.0001 inch."""
        return 10_000 if self.inches else 1000

    def number(self, steps):
        places = 4 if self.inches and self.scale == 1 else self.places
        text = f"{steps / self.per_unit * self.scale:.{places}f}"
        if self.signs and steps >= 0:
            text = "+" + text
        return text.zfill(self.digits + (text[0] in "+-")) if self.digits else text


def written(moves, how):
    """Write moves as the post-processor does; the first leads to the contour from X0 Y0."""
    lines = []

    def line(*words, ended=True):
        number = [f"N{10 * len(lines) + 110}"] if how.numbers else []
        lines.append(how.space.join([*number, *words]) + how.line_end * ended)

    def comment(text):
        line(f"{how.comment_sign}({text})", ended=False)

    if how.header:
        comment("Exported by FreeCAD")
    if how.comments:
        comment("begin preamble")
    line("G17 G54 G40 G49 G80 G90", ended=False)
    if how.relative:
        line(ended=False)
        line("G91", ended=False)
    if how.units:
        line("G20" if how.inches else "G21")
    if how.comments:
        comment(f"machine: Wire EDM, {'in' if how.inches else 'mm'}/min")
    here, last = (0, 0), ""
    for number, (code, end, centre) in enumerate(moves):
        name = "G0" if number == 0 and how.rapids else code
        words = [] if how.modal and name == last else [f"G0{name[1]}" if how.two_digits else name]
        for letter, to, was in zip("XY", end, here, strict=True):
            if not how.relative or to != was:
                words.append(letter + how.number(to - was if how.relative else to))
        if centre is not None:
            words += [letter + how.number(value) for letter, value in zip("IJ", centre, strict=True)]
        line(*words)
        here, last = end, name
    line("M05", ended=False)
    line("G17 G54 G90 G80 G40", ended=False)
    line("M2", ended=False)
    return how.newline.join([*lines, ""])


def rounded_rectangle(corner, width, height, radius):
    """Return the moves to a rectangle with four round corners and round it, clockwise from its lower side."""
    x, y = corner
    x2, y2, r = x + width, y + height, radius
    middle = (x + width // 2, y)
    return [
        ("G1", middle, None),
        ("G1", (x + r, y), None), ("G2", (x, y + r), (0, r)),
        ("G1", (x, y2 - r), None), ("G2", (x + r, y2), (r, 0)),
        ("G1", (x2 - r, y2), None), ("G2", (x2, y2 - r), (0, -r)),
        ("G1", (x2, y + r), None), ("G2", (x2 - r, y), (-r, 0)),
        ("G1", middle, None),
    ]  # fmt: skip


switches = st.builds(
    Switches, header=st.booleans(), comments=st.booleans(), comment_sign=st.sampled_from(["", ";", "'", "!"]),
    space=st.sampled_from([" ", "", "\t"]), line_end=st.sampled_from(["", ";", "*", "$", "#", "%", "EOB", " LF"]),
    newline=st.sampled_from(["\n", "\r\n", "\r"]), numbers=st.booleans(), scale=st.sampled_from([1, 1000]),
    places=st.sampled_from([3, 4, 6]), digits=st.sampled_from([0, 8, 12]), inches=st.booleans(), modal=st.booleans(),
    rapids=st.booleans(), units=st.booleans(), relative=st.booleans(), two_digits=st.booleans(), signs=st.booleans(),
)  # fmt: skip


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    folder = tmp_path_factory.mktemp("freecad")

    def read_text(text, how):
        file = folder / "part.nc"
        file.write_bytes(text.encode())
        return read_gcode(file, dialect="auto" if how.header or how.comments else "freecad")

    return read_text


@pytest.mark.slow
@given(
    how=switches, whole=st.booleans(), corner=st.tuples(st.integers(100, 5000), st.integers(100, 5000)),
    width=st.integers(2001, 20_000), height=st.integers(2001, 20_000), radius=st.integers(20, 900),
)  # fmt: skip
def test_whatever_its_switches_one_contour_is_read(read, how, whole, corner, width, height, radius):
    if how.inches and not (how.units or how.comments):
        return  # nothing in the program shows inches, so it is read as mm, as the page says
    if whole and how.scale == 1000:
        how = replace(how, places=1 if how.inches else 0)
    moves = rounded_rectangle(corner, width, height, radius)
    program = read(written(moves, how), how)
    (outline,) = program.outlines
    unit_mm = (25.4 if how.inches else 1.0) / how.per_unit
    assert program.dialect == "freecad"
    assert outline.closed
    ends = np.flatnonzero(np.diff([0, *outline.elements, 0]))
    expected = np.array([end for _, end, _ in moves]) * unit_mm
    assert outline.points_mm[ends] == pytest.approx(expected, abs=1e-6)
    arcs = [(centre, start) for (_, start, _), (_, _, centre) in pairwise(moves) if centre is not None]
    for centre, start in arcs:
        middle = (np.array(start) + centre) * unit_mm
        away = np.hypot(*(outline.points_mm - middle).T)
        assert away.min() == pytest.approx(radius * unit_mm, abs=1e-6)
    assert outline.approach_mm.tolist() == ([] if how.rapids else [[0, 0]])


PLAIN = Switches(
    header=True, comments=True, comment_sign="", space=" ", line_end="", newline="\n", numbers=False, scale=1,
    places=3, digits=0, inches=False, modal=False, rapids=False, units=True, relative=False, two_digits=False,
    signs=False,
)  # fmt: skip
BOX = rounded_rectangle((1000, 1000), 8000, 5000, 500)


def test_whole_um_with_leading_zeros_signs_and_no_blanks(read):
    how = replace(
        PLAIN, space="", scale=1000, places=0, digits=6, signs=True, two_digits=True, relative=True, line_end="*",
        units=False,
    )  # fmt: skip
    text = written(BOX, how)
    assert "G01X-003500*\n" in text
    program = read(text, how)
    assert "the coordinates span 9000: they are read in thousandths of a mm" in program.notices
    assert np.ptp(program.outlines[0].points_mm, axis=0).tolist() == pytest.approx([8, 5])
    assert math.isclose(program.outlines[0].points_mm[0, 0], 5.0)


def test_a_line_end_that_some_lines_lack_is_a_word_that_is_not_known(read):
    text = written(BOX, replace(PLAIN, line_end="*"))
    spoilt = text.replace("*\n", "\n", 4)
    with pytest.raises(InputError, match="unknown word"):
        read(spoilt, PLAIN)


def test_feeds_are_not_scaled(read):
    how = replace(PLAIN, scale=1000, places=0)
    text = written(BOX, how).replace("Y1000\n", "Y1000 F2.5\n", 1)
    assert any("feed F2.5 mm/min is not used" in notice for notice in read(text, how).notices)
