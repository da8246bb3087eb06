"""Programs that no machine could cut are refused in one line, by size and count, before they are processed."""

import time
from contextlib import contextmanager

import ezdxf
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.program import gcode_outlines, limits, outline
from edmsim.program.path import load_program, plan_path

AUTO = {"auto_offset_mm": 0.15}


@contextmanager
def refused(match, within_s=10.0):
    """Expect a one-line error within a time; such programs took minutes and gigabytes, or ended in a traceback."""
    started = time.perf_counter()
    with pytest.raises(InputError, match=match) as caught:
        yield
    assert time.perf_counter() - started < within_s
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(("lines", "match"), [
    ("G0 X0 Y0\nG1 X1e5", "unknown word"),
    (f"G0 X0 Y0\nG1 X{'9' * 300}", r":2: the number of X9{12}\.\.\. is too large: at most 1e\+09"),
    (f"G0 X0 Y0\nG1 X0.{'1' * 300} Y5.\nG{'1' * 5000} X3", ":3: unknown word .G1{11}. "),
    ("G0 X0 Y0\nG2 X1.5 Y0. I100000000000000000000. J0", "the number of I"),
    ("G0 X0 Y0\nG2 X0.001 Y0.0 I999999999. J0.", "radius of 1e.09 mm is beyond 1e.06 mm: draw a line"),
    ("G0 X0 Y0\nG1 X500000.5\nG1 Y1.", ":2: the move spans 500000 mm: no table takes more than 10000 mm"),
    ("G0 X0 Y0\nG2 X0. Y0. I9000. J0.", ":2: the arc spans 18000 mm"),
    ("TP0 TN9\nG92 X0 Y0\nG1 X5. : X2000000.", ":3: the move in the second plane"),
    ("G0 X0 Y0\nG1 X1.5\nG4 P1000000.\nG1 Y1.5", ":3: a dwell of 1e.06 s is too long: at most 86400 s"),
])  # fmt: skip
def test_numbers_beyond_reason_are_refused(tmp_path, lines, match):
    program = tmp_path / "a.ngc"
    program.write_text(lines + "\nM2\n")
    with refused(match):
        plan_path(program, "none", **AUTO)


def test_too_many_points_and_bytes_are_refused(tmp_path, monkeypatch):
    program = tmp_path / "a.ngc"
    program.write_text("G0 X0 Y0\nG2 X0. Y0. I5. J0.\nM2\n")
    assert len(plan_path(program, "none", **AUTO).contours) == 1
    monkeypatch.setattr(limits, "MOST_POINTS", 100)
    with refused("points, curves as chords, are too many: at most 100 can be cut"):
        plan_path(program, "none", **AUTO)
    monkeypatch.setattr(limits, "MOST_BYTES", 20)
    for name in ("a.ngc", "a.dxf"):
        (tmp_path / name).write_text("G0 X0 Y0\nG1 X1.5 Y0\nM2\n")
        with refused("0 MB are more than a program has"):
            load_program(tmp_path / name)


def drawing(tmp_path, draw, unit=4):
    document = ezdxf.new("R2010", units=unit)
    draw(document.modelspace())
    document.saveas(tmp_path / "a.dxf")
    return tmp_path / "a.dxf"


WAVE = [(float(x), float(x % 2)) for x in range(30)]


@pytest.mark.parametrize(("draw", "unit", "match"), [
    (lambda m: m.add_open_spline([(x * 1e5, y * 1e5) for x, y in WAVE]), 4, "a SPLINE .*: no table"),
    (lambda m: m.add_open_spline(WAVE), 6, "a SPLINE spans 29000 mm: .* a drawing unit is 1000 mm here"),
    (lambda m: m.add_circle((0, 0), 12), 6, "a CIRCLE spans 24000 mm"),
    (lambda m: m.add_circle((1e20, 0), 5), 4, "a CIRCLE has a coordinate beyond 1e.06 mm"),
    (lambda m: m.add_arc((1e20, 0), 1e20, 179.9, 180.1), 4, "an? ARC has a coordinate beyond"),
    (lambda m: m.add_ellipse((0, 0), (1e7, 0), 0.1), 4, "an? ELLIPSE has a coordinate beyond"),
    (lambda m: m.add_lwpolyline([(0, 0, 2e-5), (110, 0, 0), (5, 5, 0)], format="xyb", close=True), 4, "arc's"),
    (lambda m: m.add_lwpolyline([(0, 0), (float("nan"), 0), (5, 5)], close=True), 4, "LINE has a coordinate"),
    (lambda m: m.add_open_spline([(k % 2 * 900.0, 0.001 * k) for k in range(3000)]), 4, "SPLINE is 2699 m long"),
    (lambda m: [m.add_circle((c, 0), 20) for c in (0, 20000)], 4, "the drawing spans 20040 mm: .* is that what"),
    (lambda m: [m.add_line((3 * k, 0), (3 * k + 1, 0)) for k in range(300)], 4, "a contour is open: a gap of"),
    (lambda m: m.add_spline(), 4, "a SPLINE in it cannot be read"),
])  # fmt: skip
def test_drawings_beyond_reason_are_refused(tmp_path, draw, unit, match):
    file = drawing(tmp_path, draw, unit)
    with refused(match):
        load_program(file)


def test_what_the_library_fails_on_is_reported_by_name(tmp_path, monkeypatch):
    file = drawing(tmp_path, lambda m: m.add_open_spline([(0, 0), (1, 1), (2, 0), (3, 1)]))

    def fail(*_, **__):
        raise ZeroDivisionError("float\ndivision")

    monkeypatch.setattr("ezdxf.entities.spline.Spline.flattening", fail)
    with refused("a SPLINE in it cannot be read"):
        load_program(file)


def test_many_contours_are_refused(tmp_path, monkeypatch):
    drawn, written = drawing(tmp_path, lambda m: [m.add_circle((c, 0), 0.4) for c in range(20)]), tmp_path / "own.ngc"
    written.write_text("G21 G90\n" + "G0 X0 Y0\nG1 X0.3\n" * 11 + "M2\n")
    assert len(load_program(drawn).outlines) == 20
    monkeypatch.setattr(limits, "MOST_CONTOURS", 10)
    for file, count in ((drawn, 20), (written, 11)):
        with refused(f"{count} contours are too many: at most 10 can be cut"):
            load_program(file)


@pytest.mark.parametrize(("content", "match"), [
    ("title = 'Stahl für Messer'".encode("latin-1"), "byte 16 is not UTF-8: save the file as UTF-8"),
    ("title = 'x'\n".encode("utf-16"), "byte 0 is not UTF-8"), (b"title = " + b"9" * 5000, "not valid TOML"),
    (b"a = " + b"[" * 20_000, "not valid TOML"),
    (b"#" * 1_500_000, "this is not a file of constants: it is larger than 1 MB"),
    (b'title = "x"\nremoval_mm3_J = { value = nan, source = "own" }\n', "removal_mm3_J"),
    (b'title = "x"\nremoval_mm3_J = { value = 1' + b"0" * 400 + b', source = "own" }\n', "removal_mm3_J"),
])  # fmt: skip
def test_constants_of_wrong_encoding_or_size_are_refused(tmp_path, content, match):
    file = tmp_path / "own.toml"
    file.write_bytes(content)
    with refused(match):
        Machine.load(material=str(file))


def test_an_arc_about_a_far_centre_within_reason_is_cut(tmp_path):
    program = tmp_path / "a.ngc"
    program.write_text("G0 X0 Y0\nG2 X10. Y0. I5. J-4999.\nM2\n")
    points = plan_path(program, "none", **AUTO).contours[0].points_um
    assert np.ptp(points[:, 1]) <= 3


def first_loop(places):
    moves = [outline.CutMove((place,), None, k) for k, place in enumerate(places[1:])]
    return gcode_outlines.first_loop(places, moves, 0, len(moves), outline.JOIN_TOLERANCE_MM)


@pytest.mark.slow
def test_a_wire_that_goes_back_and_forth_is_not_compared_with_all_of_its_past():
    """If every pass is compared with all passes before it, over all moves between, three thousand take minutes."""
    started = time.process_time()
    assert first_loop([0j, 5 + 0j, 6 + 0j] * 20_000 + [0j]) is None
    assert first_loop([0j, 5 + 0j, 6 + 0j] * 20_000 + [0j, 5j, -5 + 5j, 0j]) == (0, 60_003)
    assert time.process_time() - started < 10.0


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=14))
def test_the_first_loop_is_that_of_looking_at_every_pair(steps):
    places = [complex(x, y) + 300 for x, y in steps]
    area = lambda j, k: abs(outline.signed_area(gcode_outlines.array_of([*places[j : k + 1], places[j]])))  # noqa: E731
    pairs = [(j, k) for k in range(len(places)) for j in range(k) if places[j] == places[k] and area(j, k) > 1e-4]
    assert first_loop(places) == (min(pairs, key=lambda pair: (pair[1], pair[0])) if pairs else None)
