"""A whole cut: report, windows, geometry and files agree with each other and with the craters."""

import json
import math
import os
from collections.abc import Mapping
from functools import partial

import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely

import edmsim
from edmsim.errors import InputError
from edmsim.metrology.roughness import roughness_um
from edmsim.recording.scene import write_scene
from edmsim.recording.windows import write_windows

from .conftest import FILES, timeless

pytestmark = pytest.mark.timeout(300)  # the first test makes the whole cut, and may compile the loop


def numbers(value, place=""):
    """Yield every figure of a report with its path."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from numbers(inner, f"{place}.{key}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from numbers(inner, f"{place}[{i}]")
    elif value is None or isinstance(value, int | float):
        yield place, value


def same_rows(a, b):
    """Compare tables bit for bit; missing values are equal."""
    return a.schema.equals(b.schema) and all(
        np.array_equal(x.to_numpy(), y.to_numpy(), equal_nan=True) for x, y in zip(a.columns, b.columns, strict=True)
    )


def test_every_figure_of_the_report_is_there_and_real(small_cut):
    report = small_cut.result.report
    assert (report["outcome"], report["reason"]) == ("finished", None)
    for place, value in numbers(timeless({**report, "settings": None, "reason": 0})):
        # this machine's table has no errors, its generator gives no equalising pulses, and lines have no radius
        if place not in (".settings", ".table_error_um", ".equalising") and not place.endswith(".radius_mm"):
            assert value is not None, place
            assert math.isfinite(value), place


def test_report_agrees_with_itself_and_with_the_windows(small_cut):
    report, windows = small_cut.result.report, small_cut.result.windows
    rows = {name: windows.column(name).to_numpy() for name in windows.column_names}
    assert report["pulses"] == 255 * windows.num_rows
    for kind, share in report["pulse_share"].items():
        assert share == pytest.approx(rows[kind].sum() / report["pulses"], rel=1e-12)
    assert sum(report["pulse_share"].values()) == pytest.approx(1, abs=1e-12)
    assert report["machining_time_s"] == pytest.approx(windows.num_rows * 255 * 100e-6, rel=1e-12)
    assert report["mean_voltage_V"] == pytest.approx(rows["mean_voltage_V"].mean(), rel=1e-9)
    assert report["mean_current_A"] == pytest.approx(rows["mean_current_A"].mean(), rel=1e-9)
    assert report["feed_um_s"]["max"] == rows["feed_um_s"].max()
    assert report["wire"]["temperature_K_max"] == rows["wire_temperature_K"].max()
    area_mm2 = report["overall_rate_mm2_min"] * report["machining_time_s"] / 60
    assert area_mm2 == pytest.approx(report["cutting_rate_mm2_min"] * report["cutting_time_s"] / 60, rel=1e-12)
    # the path in air: the start hole before the contour, and the end of the path, in the wire's own kerf
    air_mm = report["path_length_mm"] - area_mm2 / 5
    radius_mm = small_cut.result.path.start_hole_radius_mm
    air_s = report["machining_time_s"] - report["cutting_time_s"]
    assert radius_mm - 0.01 < air_mm < 2 * radius_mm
    assert 0 < air_s < 4e3 * radius_mm / report["feed_um_s"]["mean"]


def test_a_cut_that_never_left_its_start_hole_has_no_rate(cut_small):
    report = cut_small(max_time_s=4.0).report
    assert report["path_length_mm"] < 0.2
    assert (report["cutting_rate_mm2_min"], report["overall_rate_mm2_min"]) == (None, None)
    assert (report["cutting_time_s"], report["feed_um_s"]["share_at_limit"]) == (0.0, None)


def test_the_whole_path_was_cut(small_cut):
    points = small_cut.result.path.contours[0].points_um
    length_mm = np.hypot(*np.diff(points, axis=0).T).sum() * 1e-3
    # one loop of a 1 mm square, offset outwards, and the lead-in of 2.5 mm less the offset
    offset_mm = small_cut.result.path.offset_um * 1e-3
    assert length_mm == pytest.approx(4 + 2 * math.pi * offset_mm + 2.5 - offset_mm, abs=0.02)
    assert small_cut.result.report["path_length_mm"] == pytest.approx(length_mm, abs=0.003)


def test_removed_metal_is_what_the_craters_took(small_cut):
    report, field = small_cut.result.report, small_cut.result.field
    assert report["removed_mm3"] > 1
    areas_mm2 = [small_cut.result.contour(i).area for i in range(field.n_slices)]
    # the contour is the level of half-removed metal in cells of 4 um
    assert sum(areas_mm2) * 5 / field.n_slices == pytest.approx(report["removed_mm3"], rel=0.01)


@pytest.mark.slow
def test_roughness_is_that_of_the_mean_crater_of_sparks_and_arcs(cut_small):
    report = cut_small(t_on_us=4.0, t_period_us=14.0, max_time_s=3.0).report  # a pause short enough for arcs
    share = report["pulse_share"]
    assert share["arc"] > 0.1 * share["spark"]
    crater_um3 = 1e9 * report["removed_mm3"] / (report["pulses"] * (share["spark"] + share["arc"]))
    flatness = edmsim.Machine.load().base.discharge.crater_flatness.value
    assert report["surface"]["ra_um"] == pytest.approx(roughness_um(crater_um3, flatness), rel=1e-3)


def test_energy_and_removed_metal_belong_together(small_cut):  # T-11
    """Sparks in gas eject down to half of their metal; shorts melt a tenth of what sparks of their charge would."""
    report, machine = small_cut.result.report, edmsim.Machine.load()
    per_J, retained = machine.material.removal_mm3_J.value, 1 - machine.base.gas.ejection.value
    shorts = report["pulses"] * report["pulse_share"]["short"]
    short_J = 0.1 * shorts * 22.0 * 100.0 / 11.8 * machine.t_on_us * 1e-6
    assert report["removed_mm3"] == pytest.approx(report["energy_J"] * per_J, rel=0.1)
    assert report["energy_J"] * retained < report["removed_mm3"] / per_J < report["energy_J"] + short_J


def test_kerf_lag_and_rates_lie_where_wire_machines_lie(small_cut):
    report = small_cut.result.report
    kerf = report["kerf_um"]
    assert 250 + 2 * 10 < kerf["min"] <= kerf["mean"] <= kerf["max"] < 250 + 2 * 80  # T-14
    profile = report["profile_error_um"]
    assert 0 < profile["rms"] <= profile["p95"] <= profile["max"] < 150
    assert abs(report["wire"]["lag_um"]) < 60
    assert 0 < report["wire"]["vibration_um_rms"] < 10
    assert 293 < report["wire"]["temperature_K_max"] < 600
    assert 0.2 < report["surface"]["ra_um"] < 5
    assert 3 < report["surface"]["heat_affected_um"] < 20  # T-86
    assert 0.1 < report["surface"]["electrolysed_um"] < 3
    assert 5 < report["feed_um_s"]["mean"] <= report["feed_um_s"]["max"] <= 33.3375  # T-76
    assert report["pulse_share"]["short"] < 0.2
    assert report["mean_current_A"] < 2  # T-34


def test_the_profile_error_is_split(small_cut):
    (edge,) = small_cut.result.scene.maps
    known = np.isfinite(edge.error_um)
    np.testing.assert_allclose(edge.shares_um.sum(axis=0)[known], edge.error_um[known], atol=1e-9)
    shares = small_cut.result.report["profile_error_um"]["shares"]
    assert sum(share["of_mean_square"] for share in shares.values()) == pytest.approx(1.0)
    assert shares["drive"]["max"] == 0  # a stepper has no following error
    assert shares["path"]["max"] < 1  # the programmed path is rounded to whole um
    assert shares["planner"]["max"] < 3  # whole steps of 2 um, at corners on both axes
    assert shares["wire"]["rms"] > 0.1


def test_the_four_corners_are_found(small_cut):
    corners = small_cut.result.report["corners"]
    turns = [corner["turn_deg"] for corner in corners]
    assert turns == pytest.approx([-90] * 4)
    x0, y0 = small_cut.result.path.origin_mm
    places = {(round(c["x_mm"] - x0, 3), round(c["y_mm"] - y0, 3)) for c in corners}
    assert places == {(0, 0), (0, 1), (1, 1), (1, 0)}
    errors = [abs(c["error_um"]) for c in corners if c["error_um"] is not None]
    profile = small_cut.result.report["profile_error_um"]
    assert 2 * profile["rms"] < max(errors)  # T-14: greatest where the direction changes, tens of um at most
    assert 3 < profile["max"] < 80


def test_contour_is_a_ring_around_the_part(small_cut):
    result = small_cut.result
    part = shapely.Polygon(result.path.contours[0].nominal_mm)
    for i in (0, result.field.n_slices - 1):
        removed = result.contour(i, coordinates="table")
        assert removed.is_valid
        assert not removed.contains(part.centroid)
        assert removed.convex_hull.contains(part)
        assert removed.intersection(part).area < 0.05 * part.area


def test_contour_lies_at_mid_height_on_the_drawing_without_specks(small_cut):
    result = small_cut.result
    removed = result.contour()
    assert removed.equals(result.contour(result.field.n_slices // 2))
    assert len(removed.geoms) == len(removed.geoms[0].interiors) == 1  # the kerf around the part, and nothing else
    assert shapely.Polygon(removed.geoms[0].interiors[0]).bounds == pytest.approx((0, 0, 1, 1), abs=0.05)
    whole = result.contour(specks=True, coordinates="table")
    assert whole.area == pytest.approx(removed.area, abs=0.01)
    with pytest.raises(InputError, match="no coordinates 'drawing'; there are: program, table"):
        result.contour(coordinates="drawing")


def test_specks_are_less_than_a_hundredth_of_the_wires_section(small_cut, monkeypatch):
    sides = [math.sqrt(share * math.pi / 4) * 0.25 for share in (0.009, 0.011, 0.1)]
    squares = shapely.MultiPolygon([shapely.box(x, 0, x + side, side) for x, side in enumerate(sides)])
    monkeypatch.setattr("edmsim.metrology.edges.contour", lambda *_: squares)
    assert [len(small_cut.result.contour(specks=specks).geoms) for specks in (False, True)] == [2, 3]


def test_contour_of_a_slice_that_is_not_there(small_cut):
    with pytest.raises(InputError, match="5"):
        small_cut.result.contour(5)


def test_windows_are_as_agreed(small_cut):
    windows = small_cut.result.windows
    counts = sum(windows.column(name).to_numpy().astype(int) for name in ("short", "open", "spark", "arc"))
    assert set(counts) == {255}  # T-38
    assert set(windows.column("t_on_us").to_numpy()) == {30.0}
    assert set(windows.column("t_period_us").to_numpy()) == {100.0}
    error = windows.column("error_um").to_numpy()
    assert 0.3 < np.isfinite(error).mean() < 1  # the lead-in has none


def test_a_window_is_255_periods_without_gaps(small_cut):  # T-42
    t_ns = np.round(small_cut.result.windows.column("t_s").to_numpy() * 1e9).astype(np.int64)
    assert t_ns[0] == 25_500_000
    assert set(np.diff(t_ns)) == {25_500_000}


def test_watcher_sees_every_window(small_cut):
    windows, progress = small_cut.result.windows, small_cut.progress
    assert [p.time_s for p in progress] == windows.column("t_s").to_pylist()
    assert [p.path_um for p in progress] == windows.column("path_um").to_pylist()
    assert [(p.short, p.open) for p in progress] == list(
        zip(windows.column("short").to_pylist(), windows.column("open").to_pylist(), strict=True)
    )
    assert progress[-1].path_um == pytest.approx(progress[-1].total_um, abs=3)


def test_the_six_files_are_written_and_nothing_else(small_cut):
    folder, result = small_cut.folder, small_cut.result
    assert sorted(f.name for f in folder.iterdir()) == FILES
    assert json.loads((folder / "report.json").read_text()) == result.report
    assert same_rows(pq.read_table(folder / "windows.parquet"), result.windows)
    assert (folder / "profile.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "cut.rrd").stat().st_size > 10_000


def test_settings_say_how_to_cut_it_again(small_cut):
    report = small_cut.result.report
    settings = report["settings"]
    assert report["seed"] == 1
    assert settings["program"] == "small.ngc"
    machine = edmsim.Machine.load(height_mm=5)
    assert settings["tension_N"] == machine.tension
    assert settings["offset_um"] == pytest.approx(machine.auto_offset_mm * 1e3)
    expected = {"controller": "counts", "planner": "poscal", "resolution": "fast", "mechanics": "modal"}
    assert expected.items() <= settings.items()


def test_same_seed_same_cut_another_seed_another(small_cut, cut_small):
    again, other = cut_small(max_time_s=8), cut_small(seed=2, max_time_s=3)
    assert same_rows(again.windows, small_cut.result.windows.slice(0, again.windows.num_rows))
    first = small_cut.result.windows.slice(0, other.windows.num_rows)
    assert not other.windows.column("spark").equals(first.column("spark"))


def test_time_limit_stops_at_the_end_of_its_window(cut_small):
    report = cut_small(max_time_s=1.0).report
    assert report["outcome"] == "time-limit"
    assert "1 s" in report["reason"]
    assert 1.0 <= report["machining_time_s"] < 1.0 + 255 * 100e-6


@pytest.mark.slow
@pytest.mark.usefixtures("draws_pictures")
def test_broken_wire_leaves_a_full_report(cut_small, hot_machine, tmp_path):
    result = cut_small(out=tmp_path / "out", machine=hot_machine, tension=40.0, height_mm=20.0)
    report = result.report
    assert report["outcome"] == "wire-break"
    assert "the wire broke" in report["reason"]
    assert report["removed_mm3"] > 0
    assert 0 < report["path_length_mm"] < 7
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == FILES
    assert json.loads((tmp_path / "out" / "report.json").read_text()) == report


def test_offsets(cut_small):
    for offset, expected_um in (("0.2", 200.0), (0.15, 150.0)):
        result = cut_small(offset=offset, max_time_s=0.1)
        assert result.path.offset_um == pytest.approx(expected_um)


@pytest.mark.slow
def test_a_notice_names_a_contour_too_near_its_start_hole_to_be_measured(tmp_path):
    for radius, said in ((0.35, True), (0.45, False)):
        (file := tmp_path / "hole.ngc").write_text(f"G92 X0. Y0.\nG41 G1 X{radius}\nG3 I-{radius}\nM2\n")
        notices = edmsim.cut(file, resolution="fast", max_time_s=0.1).report["notices"]
        assert any("its wall is not measured" in notice for notice in notices) is said


@pytest.mark.slow
def test_a_constant_that_the_mechanics_leave_out_is_named(cut_small):
    def named(constants, **options):
        notices = cut_small(max_time_s=0.1, constants=constants, **options).report["notices"]
        return [notice.split()[2] for notice in notices if "had no effect" in notice]

    loose = {"table.backlash_um": 5.0, "table.friction_N": 40.0, "gap.critical_um": 9.5}
    assert named(loose) == ["table.backlash_um", "table.friction_N"]
    assert named({**loose, "geometry.x_pitch_um_m": 10.0}) == ["table.friction_N"]
    assert named(loose, drive="uhu") == named(loose, mechanics="mujoco") == []


@pytest.mark.slow
def test_result_can_be_written_later_into_a_new_folder(cut_small, tmp_path):
    result = cut_small(max_time_s=0.5)
    result.write(tmp_path / "later" / "on")
    result.write_traces(tmp_path / "new" / "traces.parquet")
    assert (tmp_path / "new" / "traces.parquet").exists()
    named = tmp_path / os.fsdecode(b"n\xfc.parquet")  # not UTF-8
    result.write_traces(named)
    assert named.read_bytes() == (tmp_path / "new" / "traces.parquet").read_bytes()
    (tmp_path / "file").touch()
    for write in (result.write_traces, partial(write_windows, result.windows), partial(write_scene, result.scene)):
        with pytest.raises(InputError, match="the output folder cannot be written to"):
            write(tmp_path / "file" / "x.parquet")
    assert sorted(f.name for f in (tmp_path / "later" / "on").iterdir()) == FILES


BAD = [
    ({"material": "cheese"}, "cheese"),
    ({"controller": "genius"}, "genius"),
    ({"controller": "fixed:feed_um_s"}, "feed_um_s"),
    ({"controller": "fixed:speed=3"}, "speed"),
    ({"controller": "fixed:feed_um_s=fast"}, "feed_um_s=fast"),
    ({"controller": "fixed:feed_um_s=-1"}, "-1"),
    ({"controller": "fixed:feed_um_s=34"}, "33.3375"),
    ({"engine": "diesel"}, "a cut has no option 'engine'; there are: machine, material"),
    ({"passes": 0}, "option passes cannot be 0: must be greater than or equal to 1"),
    ({"constants": ["gap.critical_um=5", "gap.critical_um=6"]}, "the constant gap.critical_um is given twice"),
    ({"drive": "steam"}, "no drive 'steam'; choose one of stepper, uhu, servo-module"),
    ({"drive": "uhu:P"}, "uhu parameter 'P' must read name=number"),
    ({"controller": "fixed:feed_um_s=5,feed_um_s=6"}, "controller parameter 'feed_um_s' is given twice"),
    ({"height_mm": "tall"}, "height_mm cannot be 'tall'"),
    ({"offset": 40.0}, "40 um are 0.04 mm"),
    ({"max_time_s": 0.0}, "0 s"),
    ({"max_time_s": math.nan}, "nan s"),
    ({"max_time_s": math.inf}, "inf s"),
    ({"max_time_s": 1e300}, "at most 1e+09 s"),
    ({"resume": "x"}, "option resume cannot be 'x'"),
    ({"watch": 5}, "option watch cannot be 5"),
]


@pytest.mark.parametrize(("options", "named"), BAD)
def test_bad_input_is_reported_and_nothing_is_written(cut_small, tmp_path, options, named):
    with pytest.raises(InputError) as caught:
        cut_small(out=tmp_path / "out", **options)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("out", "named"), [
    (5, "option out"), ("", "has no name"), ("a\0b", "the output folder cannot be written to: .*embedded null"),
])  # fmt: skip
def test_a_folder_that_cannot_be_is_refused(cut_small, tmp_path, monkeypatch, out, named):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=named) as caught:
        cut_small(out=out)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def long_steps(own_file):
    """Write the file of a machine that differs from the default one only in its motor step of 5 um."""
    return own_file("machines", "agiecut-dem15", ("step_um = { value = 2.0", "step_um = { value = 5.0"))


@pytest.mark.parametrize("planner", ["poscal", "exact"])
def test_a_machine_with_longer_steps_cuts_where_the_path_says(small_punch, long_steps, planner):
    windows = edmsim.cut(
        small_punch, machine=long_steps, planner=planner, controller="fixed:feed_um_s=30", resolution="fast",
        max_time_s=3,
    ).windows
    x, y, along = (windows.column(name).to_numpy() for name in ("x_um", "y_um", "path_um"))
    assert along[-1] > 60.0
    moved = np.hypot(x - x[0], y - y[0])  # the lead-in is straight
    assert np.abs(moved - (along - along[0])).max() <= 5.0
    assert set(np.unique(np.hypot(np.diff(x), np.diff(y)) % 5.0)) <= {0.0}


def test_the_controller_of_1982_refuses_other_steps_than_its_own(small_punch, long_steps):
    with pytest.raises(InputError, match=r"table.step_um is 5, and the controller of 1982 is built for motor steps"):
        edmsim.cut(small_punch, machine=long_steps, controller="mcu", resolution="fast")
