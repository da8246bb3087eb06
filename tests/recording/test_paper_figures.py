"""The figures for a paper: true to the numbers, without global state, and able to say that nothing is there."""

import dataclasses
import sys

import matplotlib
import numpy as np
import pytest

import edmsim
from edmsim.closed_loop.straight import KINDS, PulseSample, sample_pulses
from edmsim.job.result import sample_like
from edmsim.machine.setting import AIR_SHARE, WINDOW_PULSES
from edmsim.plant.constants import wire_setup
from edmsim.recording.figures.cut import (
    corner_figure,
    delay_figure,
    error_figure,
    face_figure,
    folded_hz,
    kerf_figure,
    passes_figure,
    plane_figure,
    pulses_figure,
    shares_figure,
    spectrum,
    spectrum_figure,
    wire_frequencies_hz,
)
from edmsim.recording.figures.style import WIDTH_IN, write_figure
from edmsim.recording.report import HeightError, KerfSlice, PassFigures, Report, Wall
from edmsim.recording.scene import Terrace
from edmsim.recording.windows import WindowTable, column

from .conftest import LEAD, NOTHING, changed, texts


def line(figure, label):
    """Give the data (n, 2) of the drawn line with a label."""
    (found,) = (line for axes in figure.axes for line in axes.get_lines() if line.get_label() == label)
    return np.column_stack(found.get_data())


@pytest.fixture(scope="module")
def sample():
    return sample_pulses(edmsim.Machine.load(), 25.0, seed=3, pulses=2000)


def made_up(delay_us, open_, deflection_um=None):
    kind = np.concatenate([np.full(len(delay_us), KINDS.index("spark")), np.full(open_, KINDS.index("open"))])
    delays = np.concatenate([delay_us, np.full(open_, np.nan)])
    moved = np.zeros((len(kind), 5, 2)) if deflection_um is None else deflection_um
    return PulseSample(edmsim.Machine.load(), 25.0, 100.0, kind, delays, moved)


def test_a_style_of_the_user_does_not_get_into_the_figures(cut):
    own = {"axes.facecolor": "black", "text.usetex": True, "figure.constrained_layout.use": True}
    with matplotlib.rc_context(own):
        figure = kerf_figure(cut.report)
        assert matplotlib.rcParams["axes.facecolor"] == "black"
    assert all(axes.get_facecolor() == (1, 1, 1, 1) for axes in figure.axes)
    assert not any(text.get_usetex() for text in figure.findobj(matplotlib.text.Text))
    assert figure.get_layout_engine() is None  # the margins are the figure's own


@pytest.mark.parametrize(("draw", "said"), [
    (lambda cut: kerf_figure(None), "report cannot be None: give Report"),
    (lambda cut: corner_figure(cut.scene, cut.windows, 1.0), r"corner cannot be 1\.0: give int \| None"),
    (lambda cut: write_figure(None, "a.png"), "figure cannot be None: give Figure"),
])  # fmt: skip
def test_what_a_figure_cannot_be_drawn_of_is_refused(cut, draw, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(edmsim.InputError, match=said):
        draw(cut)


@pytest.mark.slow
def test_every_figure_is_one_column_wide_and_needs_no_pyplot(cut, sample, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it would raise
    for figure in (
        error_figure(cut.scene), shares_figure(cut.scene), corner_figure(cut.scene, cut.windows),
        kerf_figure(cut.report),
        pulses_figure(cut.windows), plane_figure(cut.windows), delay_figure(sample, cut.windows),
        spectrum_figure([sample], "fast"),
    ):  # fmt: skip
        figure.canvas.draw()
        assert figure.get_figwidth() == WIDTH_IN
        box = figure.get_tightbbox()
        assert box.x0 > -0.02
        assert box.x1 < WIDTH_IN + 0.02  # nothing is cut off at the sides
        assert box.y1 < figure.get_figheight() + 0.02


def test_labels_of_nearly_constant_series_are_not_cut_off(cut):
    rising = np.linspace(0.0, 0.001, 20)
    figure = pulses_figure(changed(cut.windows.slice(0, 20), mean_voltage_V=29.999 + rising, coverage=rising))
    figure.canvas.draw()
    assert figure.get_tightbbox().x0 > -0.01


def test_a_series_without_values_has_no_scale(cut):
    figure = pulses_figure(changed(cut.windows, mean_delay_us=np.full(cut.windows.num_rows, np.nan)))
    assert [len(axes.get_yticks()) for axes in figure.axes if "delay" in axes.get_ylabel()] == [0]
    assert "not measured" in texts(figure)


def test_the_worst_corner_is_chosen_and_any_other_can_be(cut):
    assert "X 10.000 Y 6.000" in texts(corner_figure(cut.scene, cut.windows))  # of the program
    assert "−9.1 µm" in texts(corner_figure(cut.scene, cut.windows, 0))
    with pytest.raises(edmsim.InputError, match="no corner 4: the cut has corners 0 to 3"):
        corner_figure(cut.scene, cut.windows, 4)


def test_the_corner_shows_the_wire_behind_its_guides(cut):
    figure = corner_figure(cut.scene, cut.windows, 1)  # between an edge along +X and one along +Y
    guides, wire = line(figure, "guides"), line(figure, "wire")
    behind = np.nanmean((guides - wire)[guides[:, 0] < -200], axis=0)  # on the edge along +X
    assert behind == pytest.approx([4.0, 0.0], abs=0.3)
    error = line(figure, "profile error (+ metal left)")
    assert np.abs(error[:, 0]).min() == 0.0
    # a drive's guides are behind what is commanded, and the wire behind them
    led = corner_figure(cut.scene, changed(cut.windows, following_x_um=np.full(len(cut.windows), 3.0)), 1)
    for name, before in (("guides", guides), ("wire", wire)):
        on_edge = (before[:, 0] < -200) & (before[:, 0] > -600)
        np.testing.assert_allclose((before - line(led, name))[on_edge], [[3.0, 0.0]] * on_edge.sum(), atol=1e-9)
    assert error[np.abs(error[:, 0]).argmin(), 1] == pytest.approx(cut.scene.maps[0].error_um[500], abs=1e-9)
    # a wire that leans is shown at mid height, here 2 mm beside its lower guide
    scene = dataclasses.replace(cut.scene, lead=LEAD)
    leaning = corner_figure(scene, changed(cut.windows, x_um=column(cut.windows, "x_um") - 2000.0), 1)
    np.testing.assert_allclose(line(leaning, "guides"), guides, atol=1e-9)
    np.testing.assert_allclose(line(leaning, "wire"), wire, atol=1e-9)


def test_a_corner_of_a_leaning_wall_is_drawn_at_the_height_of_its_metal(cut):
    upright = corner_figure(cut.scene, cut.windows, 1)
    stepped = dataclasses.replace(cut.scene, lead=LEAD, terraces=(Terrace(cut.scene.middle_edges_mm(), 8.0),))
    height_mm = stepped.middle_mm()
    assert height_mm < 8.0
    (edge,), slice_index = stepped.maps, stepped.middle_slice()
    lean = np.array([0.1, 0.0])
    metal = tuple(line + lean * (height_mm - 10.0) for line in cut.scene.middle_edges_mm())
    leaning = dataclasses.replace(
        stepped, walls_mm=((edge.nominal_mm - 10.0 * lean, edge.nominal_mm + 10.0 * lean),),
        cut_edges_mm=(*stepped.cut_edges_mm[:slice_index], metal, *stepped.cut_edges_mm[slice_index + 1 :]),
    )
    figure = corner_figure(leaning, changed(cut.windows, x_um=column(cut.windows, "x_um") - 2000.0), 1)
    for name in ("guides", "wire", "nominal edge"):
        np.testing.assert_allclose(line(figure, name), line(upright, name), atol=1e-9)
    here = f"metal edge, {height_mm:.3g} mm high"
    np.testing.assert_allclose(line(figure, here), line(upright, "metal edge, mid height"), atol=1e-9)


def test_the_kerf_is_drawn_from_wire_to_wall(cut):
    section = [
        KerfSlice(z, 9, wall(155.0 + z), wall(160.0)) for z in (2.5, 7.5, 12.5, 17.5)
    ]
    report = dataclasses.replace(cut.report, kerf_section=section, settings={"wire_diameter_um": 250.0})
    figure = kerf_figure(report)
    part, rest = (axes.get_lines()[0].get_data() for axes in reversed(figure.axes))
    np.testing.assert_allclose(part, [[32.5, 37.5, 42.5, 47.5], [2.5, 7.5, 12.5, 17.5]])
    np.testing.assert_allclose(rest[0], 35.0)
    low, high = figure.axes[0].get_xlim()
    assert low > high  # the wire stands between both walls
    assert figure.axes[0].get_ylim() == (0.0, 20.0)


def wall(mean_um):
    return Wall(mean_um, mean_um - 3, mean_um + 3)


def test_the_plane_holds_every_window_and_the_path_between(cut):
    figure = plane_figure(cut.windows)
    dots = figure.axes[0].get_lines()[0].get_data()
    np.testing.assert_allclose(dots[0], 100 * cut.windows["open"].to_numpy() / 255)
    np.testing.assert_allclose(dots[1], 100 * cut.windows["short"].to_numpy() / 255)
    (path,) = figure.axes[0].collections
    steps = np.array(path.get_segments())
    assert len(steps) == 119
    np.testing.assert_array_equal(steps[1:, 0], steps[:-1, 1])


@pytest.mark.slow
def test_the_unit_of_small_currents_is_on_the_figure(cut):
    small = 0.2 * column(cut.windows, "mean_current_A")  # its ticks have more digits
    figure = pulses_figure(changed(cut.windows, mean_current_A=small))
    figure.canvas.draw()
    assert max(axes.yaxis.label.get_window_extent().x1 for axes in figure.axes) < figure.bbox.x1


def test_few_ignitions_are_read_on_more_than_one_tick():
    below = delay_figure(made_up(np.linspace(0.5, 30.0, 40), 160)).axes[1]
    low, high = below.get_ylim()
    assert ((below.get_yticks() >= low) & (below.get_yticks() <= high)).sum() >= 4


def test_an_exponential_delay_is_a_straight_line_with_its_mean():
    delay = np.random.default_rng(4).exponential(20.0, 4000)
    lit = delay[delay < 30.0]
    figure = delay_figure(made_up(lit, len(delay) - len(lit)))
    drawn = texts(figure)
    mean = float(drawn.partition("from 10 µs, mean ")[2].partition(" ")[0])
    assert mean == pytest.approx(20.0, rel=0.08)  # some 1500 breakdowns in the tail know it to 3 %
    survival = line(figure, "pulses")
    np.testing.assert_allclose(survival[:, 1], np.exp(-survival[:, 0] / 20.0), atol=0.03)


@pytest.mark.slow
def test_a_ringing_wire_has_its_line_in_the_spectrum():
    t_s = 1e-4 * np.arange(8000)
    moved = np.zeros((8000, 5, 2))
    moved[:, :, 0] = 3.0 * np.sin(2 * np.pi * 1700.0 * t_s)[:, None]
    frequency, along, across = spectrum(made_up(np.ones(8000), 0, moved))
    assert frequency[along.argmax()] == pytest.approx(1700.0, abs=10.0)
    assert along.sum() * frequency[1] == pytest.approx(4.5, rel=0.02)  # its mean square
    assert not across.any()


def test_modes_follow_the_string_and_fold_at_half_the_pulse_frequency():
    """By Rayleigh's quotient: water moves with the wire on the middle half of its length."""
    machine = edmsim.Machine.load(height_mm=20.0, tension=10.0)
    frequency = wire_frequencies_hz(machine, "fast")
    n = np.arange(1, 5)
    in_slot = 0.5 - (-1.0) ** n * np.sin(n * np.pi / 2) / (n * np.pi)  # of a mode's motion, on half of its length
    per_length = np.pi / 4 * (250e-6) ** 2 * 8400.0 + in_slot * wire_setup(machine).slot_mass_kg_m
    np.testing.assert_allclose(frequency[:4], n * np.sqrt(10.0 / per_length) / 2 / 0.040, rtol=0.02)
    np.testing.assert_allclose(folded_hz(np.array([1e3, 4.9e3, 5.1e3, 10e3]), 10e3), [1e3, 4.9e3, 4.9e3, 0])


def test_the_simulated_wire_vibrates_near_its_first_mode(sample):
    frequency, along, _ = spectrum(sample)
    first = wire_frequencies_hz(sample.machine, "fast")[0]
    # the pull of the field softens it, and the film broadens it by the damping ratio: some 0.3 to either side
    assert 0.6 * first < frequency[along.argmax()] < 1.3 * first


def test_single_pulses_are_those_of_windows(sample):
    plant_shares = {kind: sample.share(kind) for kind in KINDS}
    assert sum(plant_shares.values()) == pytest.approx(1.0)
    from edmsim.closed_loop.straight import cut_straight

    straight = cut_straight(sample.machine, 25.0, 3, settle_s=3.0, seconds=2.0)
    for kind in ("short", "open", "spark"):
        assert sample.share(kind) == pytest.approx(straight.share(kind), abs=0.05)
    assert np.nanmean(sample.delay_us) == pytest.approx(straight.mean_delay_us, rel=0.08)
    again = sample_pulses(sample.machine, 25.0, seed=3, pulses=2000)
    np.testing.assert_array_equal(again.delay_us, sample.delay_us)


@pytest.mark.slow
def test_a_sample_of_a_cut_has_its_setting(small_cut):
    result = small_cut.result
    drawn = sample_like(result.report, result.windows, pulses=300)
    assert drawn.machine.height_mm == 5.0
    feed_um_s, open_ = (result.windows[name].to_numpy() for name in ("feed_um_s", "open"))
    assert drawn.feed_um_s == np.median(feed_um_s[(feed_um_s > 0) & (open_ < AIR_SHARE * WINDOW_PULSES)])
    assert drawn.period_us == 100.0
    settings = {**result.report.settings, "material": "copper"}  # as if the material's file had changed
    with pytest.raises(edmsim.InputError, match="other constants than the cut had"):
        sample_like(dataclasses.replace(result.report, settings=settings), result.windows)


def test_what_cannot_be_sampled_is_said(cut):
    machine = edmsim.Machine.load(generator="iso-energetic")
    with pytest.raises(edmsim.InputError, match="generators of a fixed period"):
        sample_pulses(machine, 20.0)
    with pytest.raises(edmsim.InputError, match="at 0 um/s are not a cut"):
        sample_pulses(edmsim.Machine.load(), 0.0)
    with pytest.raises(edmsim.InputError, match="no window with metal"):
        sample_like(cut.report, WindowTable().to_arrow())
    with pytest.raises(edmsim.InputError, match="at least 32 pulses"):
        spectrum_figure([made_up(np.ones(20), 0)])


def test_a_cut_that_left_nothing_says_so(cut):
    nothing = WindowTable().to_arrow()
    empty = [{"height_mm": 10.0, "places": 0, "part": wall(np.nan), "rest": wall(np.nan)}]
    for figure, said in (
        (error_figure(NOTHING), "no profile error"),
        (shares_figure(NOTHING), "no shares"),
        (corner_figure(NOTHING, nothing), "no corner"),
        (kerf_figure(dataclasses.replace(cut.report, kerf_section=empty)), "no kerf"),
        (pulses_figure(nothing), "no pulses"),
        (plane_figure(nothing), "no pulses"),
        (delay_figure(made_up(np.zeros(0), 50)), "no ignition delay"),
    ):
        assert said in texts(figure)


def test_a_corner_without_windows_near_it_is_drawn(cut):
    scene = dataclasses.replace(cut.scene, cut_edges_mm=())
    figure = corner_figure(scene, cut.windows.slice(0, 2), 2)
    figure.canvas.draw()
    assert np.isnan(line(figure, "guides")).all()


def pass_row(number, left_um):
    slices_um, begin_s = [left_um, left_um + 2.0, left_um], 60.0 * number
    return PassFigures(
        1, number, "profile", False, begin_s, begin_s + 50.0, 5.0, 20.0, 155.0, None, left_um, None, 2.0, 2.0, None,
        None, slices_um, 1.5 / number, None, 0.1, 0.2,
    )  # fmt: skip


def test_passes_are_drawn_over_the_height(cut):
    heights = [HeightError(z, 0.0, 1.0) for z in (5.0, 10.0, 15.0)]
    figure = passes_figure(Report(passes=[pass_row(1, 90.0), pass_row(2, 0.0)], heights=heights))
    wall = figure.axes[0]
    np.testing.assert_allclose(wall.get_lines()[1].get_data(), [[0.0, 2.0, 0.0], [5.0, 10.0, 15.0]])
    assert [bar.get_height() for bar in figure.axes[2].patches] == [90.0, 0.0]
    assert "no passes" in texts(passes_figure(cut.report))


def test_the_face_is_drawn_unrolled(cut):
    edge = cut.scene.maps[0]
    face = np.tile(edge.error_um, (4, 1))
    scene = dataclasses.replace(cut.scene, maps=(dataclasses.replace(edge, face_um=face),))
    (mesh,) = face_figure(scene).axes[0].collections
    np.testing.assert_array_equal(np.ma.filled(mesh.get_array(), np.nan), face)
    assert "no face" in texts(face_figure(cut.scene))
