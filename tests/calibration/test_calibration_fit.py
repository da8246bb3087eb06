"""The fit: known constants come back within their intervals, and what a log cannot tell is not told."""

import json
import math
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import edmsim
from edmsim import models
from edmsim.calibration import Fit, Log, calibrate
from edmsim.calibration import fit as fitting
from edmsim.calibration.comparison import StretchComparison, simulate
from edmsim.calibration.fit import FittedConstant, machine_of, remark
from edmsim.calibration.log import COLUMNS, STRETCH_WINDOWS, Stretch, stretches
from edmsim.calibration.output import correlated, write
from edmsim.closed_loop.straight import Traverse
from edmsim.errors import INTERRUPTED
from edmsim.job.options import METADATA_KEY, CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import share_of, value_at, with_values
from edmsim.runs import RunTable


def log_of(table):
    return Log("known", {name: table[name].to_numpy() for name in COLUMNS})


@pytest.fixture(scope="module", autouse=True)
def short():
    """Compare two stretches, which settle over a third of a millimetre: a tenth of the time, with the same bars."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edmsim.calibration.fit.MOST_STRETCHES", 2)
        patch.setattr("edmsim.calibration.comparison.NOISE_CUTS", 8)
        patch.setattr("edmsim.calibration.comparison.WHOLLY_SETTLED_DIAMETERS", 1.3)
        yield


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """File of the cuts that `recovered` simulates."""
    return tmp_path_factory.mktemp("fit") / "runs.jsonl"


@pytest.fixture(scope="module")
def recovered(known, runs):
    """Give what is found of two known constants and one that no log of a short time can tell."""
    constants = [*known.truth, "wire.strength_MPa"]
    return calibrate(log_of(known.table), known.machine, constants, seed=3, table=RunTable(runs))


@pytest.mark.slow
def test_a_resumed_fit_equals_the_uninterrupted_one(known, recovered, runs, tmp_path, monkeypatch):
    made, part = list[int](), tmp_path / "part.jsonl"
    lines = runs.read_bytes().splitlines(keepends=True)
    part.write_bytes(b"".join(lines[:-2]) + lines[-2][:40])  # killed while it wrote the last but one
    monkeypatch.setattr("edmsim.calibration.comparison.simulate", lambda *args: made.append(1) or simulate(*args))
    resumed = calibrate(
        log_of(known.table), known.machine, [*known.truth, "wire.strength_MPa"], seed=3, table=RunTable(part)
    )
    assert (resumed.constants, resumed.misfit) == (recovered.constants, recovered.misfit)
    assert len(made) == 2


@pytest.mark.slow
def test_known_constants_come_back_within_their_intervals(known, recovered):
    assert [constant.name for constant in recovered.constants] == list(known.truth)
    for constant in recovered.constants:
        low, high = constant.interval
        assert low <= known.truth[constant.name] <= high
        assert not low <= constant.before <= high  # where the search began is ruled out
        assert high - low < 0.6 * (constant.range[1] - constant.range[0])
    assert recovered.misfit < 2.0


@pytest.mark.slow
def test_a_log_made_under_a_gap_controller_is_fitted(steered):
    """The statistics are judged where the log was made: where the search begins other shares of pulses are open.

    The controller has a few shorts less than the fixed feed of the comparison, which bends both constants a little.
    """
    fit = calibrate(log_of(steered.table), steered.machine, list(steered.truth), seed=3)
    assert not fit.undetermined
    particles, removal = fit.constants
    assert removal.value == pytest.approx(steered.truth[removal.name], rel=0.02)
    assert particles.value == pytest.approx(steered.truth[particles.name], abs=0.007)  # a tenth of its range
    for constant in fit.constants:
        assert not constant.interval[0] <= constant.before <= constant.interval[1]
    assert fit.misfit < 2.0


@pytest.mark.slow
def test_what_the_log_cannot_tell_keeps_its_value(known, recovered):
    assert recovered.undetermined == {"wire.strength_MPa": "the statistics do not depend on it"}
    assert recovered.machine.wire == known.machine.wire


@pytest.mark.slow
def test_of_constants_that_do_the_same_the_value_is_named_at_which_the_other_holds(known, monkeypatch):
    class Search:
        def __init__(self, comparison, names, start):
            self.names = list(names)

        def run(self):
            pass

        def standard_errors(self):
            return np.array([0.5, 0.1])[-len(self.names) :]

    monkeypatch.setattr(fitting, "StretchComparison", lambda machine, *_: SimpleNamespace(machine=machine))
    monkeypatch.setattr(fitting, "_determined_alone", lambda comparison, names, at: list(names))
    monkeypatch.setattr(fitting, "_Search", Search)
    monkeypatch.setattr(fitting, "_result", lambda search, error, undetermined: undetermined)
    assert calibrate(log_of(known.table), known.machine, list(known.truth)) == {
        "gap.particle_share":
            "another value of material.removal_mm3_J does the same; the fit holds for 0.05 only",
    }  # fmt: skip


def test_a_constant_with_a_small_effect_is_fitted_if_simulated_cuts_do_not_scatter(monkeypatch):
    """Errors of counter and meter are the log's alone, and add nothing to the difference of two simulated cuts."""
    machine = Machine.load(height_mm=10.0)
    bounds = machine.uncertain()["gap.particle_share"].range

    def shorts(particle_share):
        return 0.05 + 6e-3 * share_of(bounds, particle_share)  # six times the error of a counter over the range

    def steady(machine, *_):
        return np.tile([shorts(machine.base.gap.particle_share.value), 0.4, 25.0, 0.5, 5.0], (10, 1))

    monkeypatch.setattr("edmsim.calibration.comparison.simulate", steady)
    truth = value_at(bounds, 0.8)
    rows = np.tile([30.0, 255 * shorts(truth), 255 * 0.4, 25.0, 0.5, 5.0, 30.0, 100.0], (1300, 1))
    fit = calibrate(Log("steady", dict(zip(COLUMNS, rows.T, strict=True))), machine, ["gap.particle_share"])
    assert [constant.value for constant in fit.constants] == pytest.approx([truth], rel=1e-3)


@pytest.mark.slow
def test_the_fitted_set_up_can_be_cut_with(known, recovered, tmp_path):
    files = write(recovered, "known.parquet", tmp_path / "fitted.toml")
    assert {part: file.name for part, file in files.items()} == {
        "machine": "fitted.toml", "material": "fitted-material.toml"
    }  # fmt: skip
    assert len(list(tmp_path.iterdir())) == 2
    again = edmsim.Machine.load(str(files["machine"]), material=str(files["material"]), height_mm=10.0)
    fitted = {constant.name: constant for constant in recovered.constants}
    assert again.base.gap.particle_share.value == fitted["gap.particle_share"].value
    assert again.material.removal_mm3_J.value == fitted["material.removal_mm3_J"].value
    assert again.base.gap.particle_share.range == (0.03, 0.1)
    assert "fitted to known.parquet" in again.base.gap.particle_share.source
    assert again.base.dielectric == known.machine.base.dielectric


@pytest.mark.slow
def test_a_log_that_tells_nothing_is_refused(known):
    one = log_of(known.table.slice(0, 990))
    in_kV = replace(one, columns={**one.columns, "mean_voltage_V": one.columns["mean_voltage_V"] / 1000})
    with pytest.raises(edmsim.InputError, match=r"none of the constants .*is far above 1: see whether units, set-up"):
        calibrate(in_kV, known.machine, [*known.truth])
    with pytest.raises(edmsim.InputError, match=r"none of the constants \(wire.strength_MPa: the statistics do"):
        calibrate(one, known.machine, ["wire.strength_MPa"])
    with pytest.raises(edmsim.InputError, match="no constant to fit"):
        calibrate(one, known.machine, [])


@pytest.mark.slow
def test_the_command_prints_and_writes_what_was_fitted(known, recovered, log_file, monkeypatch, edmsim):
    """It fits with the settings of the command line, and prints what that gave; here the fit above."""

    def fitted(log, machine, only, **options):
        assert (list(only), options["seed"], len(log)) == (["material.removal_mm3_J"], 5, 990)
        assert machine == known.machine
        return recovered

    monkeypatch.setattr("edmsim.calibration.calibrate", fitted)
    out = log_file.parent / "fitted.toml"
    options = ("--out", out, "--height", "10", "--fit", "material.removal_mm3_J", "--json")
    shown = edmsim("calibrate", log_file, *options, "--seed", "5")
    assert shown.status == 0
    document = json.loads(shown.out)
    as_lists = [c._asdict() | {"interval": [*c.interval], "range": [*c.range]} for c in recovered.constants]
    assert document["constants"] == as_lists
    assert document["misfit"] == recovered.misfit
    assert [list(row["model"].values()) for row in document["stretches"]] == recovered.simulated.tolist()
    assert document["files"] == {"machine": str(out), "material": str(out.with_name("fitted-material.toml"))}
    known.machine.load(str(out), material=document["files"]["material"])
    said = edmsim("calibrate", log_file, *options[:-1], "--seed", "5").out
    assert f"Cut with it: edmsim cut PROGRAM --resolution fast --machine {out} --material" in said


def test_the_logged_machine_has_the_logs_statistics(known):
    stretch = stretches(log_of(known.table), 325.0)[0]
    right, wrong = (
        Stretch(0, 22.0, 30.0, 100.0, simulate(machine, stretch, STRETCH_WINDOWS, 1, "fast")).mean - stretch.mean
        for machine in (with_values(known.machine, known.truth), known.machine)
    )
    noise = stretch.batches.std(axis=0) / math.sqrt(len(stretch.batches))
    assert (np.abs(right) < 6 * noise).all()
    assert np.abs(wrong / noise).max() > 15


def test_a_cut_settles_for_as_long_as_its_log_did_but_not_for_ever(known, monkeypatch):
    settled_um, run = [], Traverse.run
    monkeypatch.setattr("edmsim.calibration.comparison.WHOLLY_SETTLED_DIAMETERS", 5.0)

    def briefly(traverse, seconds):
        settled_um.append(22.0 * seconds)
        return run(traverse, 0.1)

    monkeypatch.setattr(Traverse, "run", briefly)
    for travelled_um in (0.0, 700.0, 1e6):
        simulate(known.machine, Stretch(0, 22.0, 30.0, 100.0, np.zeros((1, 5)), travelled_um), 40, 0, "fast")
    assert settled_um == pytest.approx([325.0, 700.0, 1250.0])


def test_cuts_with_another_mjcf_are_simulated_again(tmp_path, monkeypatch):
    file, mjcf, table = tmp_path / "own.toml", tmp_path / "own.xml", RunTable()
    file.write_text('like = "agiecut-dem15"\nmodel = "own.xml"\n')
    mjcf.write_text(models.path("agiecut_dem15.xml").read_text())
    batches = np.random.default_rng(0).random((10, 5))
    monkeypatch.setattr("edmsim.calibration.comparison.simulate", lambda *_: batches)
    made = []
    for _ in range(2):
        StretchComparison(Machine.load(file), [Stretch(0, 22.0, 30.0, 100.0, batches)], 0, "fast", table, None, 1)
        made.append(len(table.rows))
        mjcf.write_text(mjcf.read_text().replace('mass="25"', 'mass="60"'))
    assert made[1] == 2 * made[0]


def test_a_wire_driven_into_the_metal_counts_as_shorted(known):
    stretch = stretches(log_of(known.table), 325.0)[0]
    jammed = Stretch(0, 350.0, stretch.t_on_us, stretch.t_period_us, stretch.batches)
    batches = simulate(known.machine, jammed, 80, 0, "fast")
    np.testing.assert_array_equal(batches[-1, :3], [1.0, 0.0, 0.0])


@given(st.floats(0.0, 1.0), st.sampled_from([(1.0, 2.0), (0.0, 20.0), (1e-7, 7e-7), (5.0, 20.0), (5e3, 2e5)]))
def test_a_share_of_a_range_and_its_value_are_one(share, bounds):
    assert share_of(bounds, value_at(bounds, share)) == pytest.approx(share, abs=1e-9)


def test_correlated_errors_are_reported():
    constants = tuple(FittedConstant(name, 1.0, 1.0, (0.9, 1.1), (0.0, 2.0), "") for name in ("gap.a", "gap.b"))
    none = np.zeros((0, 5))
    fit = Fit(edmsim.Machine.load(), constants, {}, np.array([[1.0, -0.97], [-0.97, 1.0]]), 1.0, [], none, none)
    assert correlated(fit) == [
        "errors of gap.b and gap.a are correlated by -0.97: their combination is known better than either"
    ]


# --- refusals ---


def test_constants_that_cannot_be_fitted_are_refused(known):
    log = log_of(known.table)
    for only, said in ((["gap.nonsense"], "'gap.nonsense' is not a section or constant"),
                       (["gap.contact_um"], "'gap.contact_um' is not a section or constant with")):  # fmt: skip
        with pytest.raises(edmsim.InputError, match=said):
            calibrate(log, known.machine, only)
    with pytest.raises(edmsim.InputError, match=r"\d\d constants cannot be determined from 10 statistics"):
        calibrate(log, known.machine, ["gap", "discharge", "dielectric", "guides"])


def test_a_log_without_a_steady_stretch_is_refused(known):
    said = "known: no stretch of 400 windows can be used: after 325 um.* is 22 um/s"
    with pytest.raises(edmsim.InputError, match=said):
        calibrate(log_of(known.table.slice(0, 300)), known.machine)


def test_a_setting_the_generator_refuses_is_refused(known):
    strong = log_of(known.table.set_column(6, "t_on_us", pa.array(np.full(len(known.table), 90.0))))
    with pytest.raises(edmsim.InputError, match="above the generator's 2 A"):
        calibrate(strong, known.machine)


@pytest.mark.parametrize(("name", "most"), [("mean_voltage_V", "100 V"), ("mean_current_A", "8.475 A")])
def test_voltage_and_current_beyond_the_generator_are_refused(known, name, most):
    milli = pa.array(1000 * known.table[name].to_numpy())
    log = log_of(known.table.set_column(COLUMNS.index(name), name, milli))
    with pytest.raises(edmsim.InputError, match=rf"windows \d+ to \d+: {name} is .*, above the generator's {most}"):
        calibrate(log, known.machine)


@pytest.fixture
def log_file(known, tmp_path):
    pa.parquet.write_table(known.table.slice(0, 990), tmp_path / "log.parquet")
    return tmp_path / "log.parquet"


@pytest.mark.parametrize(("options", "said"), [
    (("--out", "fitted.json"), "the fitted machine is written as .toml"),
    (("--out", "log.parquet/fitted.toml"), "cannot be written to: File exists"),
    (("--out", "fitted.toml", "--fit", "gap.nonsense"), "'gap.nonsense' is not a section"),
    (("--out", "fitted.toml", "--resolution", "finest"), "finest"),
    (("--out", "fitted.toml", "--material", "butter"), "unknown material 'butter'"),
])  # fmt: skip
def test_bad_usage_is_one_line_and_2_and_nothing_is_written(log_file, monkeypatch, edmsim, options, said):
    monkeypatch.chdir(log_file.parent)
    shown = edmsim("calibrate", log_file, *options)
    assert (shown.status, shown.err.count("\n")) == (2, 1)
    assert said in shown.err
    assert [file.name for file in log_file.parent.iterdir()] == ["log.parquet"]


class Compared(NamedTuple):
    """What the log was compared with, and what was said."""

    machine: edmsim.Machine
    resolution: str
    said: str


@pytest.fixture
def compared(known, tmp_path, monkeypatch, edmsim):
    """Calibrate with the log of a cut of these settings, up to the first simulated cut."""
    comparisons = []

    def stop(machine, stretch, windows, seed, resolution):
        comparisons.append((machine, resolution))
        raise KeyboardInterrupt

    def run_with(settings, *options):
        metadata = None if settings is None else {METADATA_KEY: settings.model_dump_json()}
        log = tmp_path / "log.parquet"
        pa.parquet.write_table(known.table.slice(0, 990).replace_schema_metadata(metadata), log)
        monkeypatch.setattr("edmsim.calibration.comparison.simulate", stop)
        shown = edmsim("calibrate", log, "--out", tmp_path / "fitted.toml", *options)
        assert shown.status == INTERRUPTED
        return Compared(*comparisons[0], shown.err)

    return run_with


def test_a_log_is_compared_at_the_settings_it_was_cut_with(compared):
    settings = CutSettings(
        height_mm=10, material="copper", wire="brass-200", tension=9, generator="ignition-pulse", t_on_us=15,
        t_period_us=120, resolution="default", seed=4,
    )  # fmt: skip
    machine, resolution, said = compared(settings)
    assert (machine, resolution) == (settings.load_machine(), "default")
    assert said == "edmsim: interrupted; run the same command to resume\n"


def test_options_hold_against_the_log_and_are_reported(compared):
    settings = CutSettings(height_mm=10, material="copper", resolution="default")
    machine, resolution, said = compared(settings, "--height", 20, "--material", "copper", "--resolution", "fast")
    assert (machine.height_mm, machine.material_name, resolution) == (20.0, "copper", "fast")
    assert said.splitlines()[:-1] == [
        "edmsim: height_mm 20.0 is used, though the log was cut with 10.0",
        "edmsim: resolution fast is used, though the log was cut with default",
    ]


def test_of_a_log_whose_workpiece_changed_its_height_the_greatest_is_taken(compared):
    machine, _, said = compared(CutSettings(height_mm=10, heights=[(1, 12)]))
    assert machine.height_mm == 12.0
    assert "the height changed in the cut of this log: 12 mm is taken for all of it" in said


OVERRIDES = {"gap.critical_um": 9.5, "material.burning_voltage_V": 23.0, "gap.contact_um": 1.5}


def test_constants_of_the_cut_are_where_a_search_starts_or_are_held(compared):
    settings = CutSettings(height_mm=10, constants=OVERRIDES)
    machine, _, said = compared(settings, "--fit", "gap.critical_um,material.removal_mm3_J")
    assert machine.base.gap.contact_um.value == 1.5
    assert machine.material.burning_voltage_V.value == 23.0
    ranges = {name: constant.range for name, constant in edmsim.Machine.load().uncertain().items()}
    # a place around the start, as sensitivities are taken
    assert machine.base.gap.critical_um.range == ranges["gap.critical_um"]
    assert said.splitlines()[:-1] == [
        "edmsim: gap.contact_um is held at 1.5, as in the cut of the log",
        "edmsim: material.burning_voltage_V is held at 23, as in the cut of the log",
    ]


def test_of_another_material_the_files_constants_are_used(compared):
    machine, _, said = compared(CutSettings(height_mm=10, constants=OVERRIDES), "--material", "copper")
    assert machine.material.burning_voltage_V == edmsim.Machine.load(material="copper").material.burning_voltage_V
    assert "the log was cut with another value of material.burning_voltage_V: that of the file given is used" in said
    assert "gap.contact_um is held at 1.5" in said


def test_a_constant_of_the_cut_beyond_its_range_is_reported_and_can_be_written(compared, tmp_path):
    settings = CutSettings(height_mm=10, constants={"gap.critical_um": 14.0, "material.removal_mm3_J": 5e-2})
    _, _, said = compared(settings, "--fit", "gap.critical_um")
    assert "gap.critical_um was 14 in the cut of the log, outside its range 8..10: the fitted value is inside" in said
    constants = (FittedConstant("gap.critical_um", 14.0, 9.9, (9.0, 10.0), (8.0, 10.0), ""),)
    machine = with_values(machine_of(settings), {"gap.critical_um": 9.9})
    fit = Fit(machine, constants, {}, np.eye(1), 1.0, [], np.zeros((0, 5)), np.zeros((0, 5)))
    files = write(fit, "log", tmp_path / "fitted.toml", ["material.removal_mm3_J"])
    again = edmsim.Machine.load(str(files["machine"]), material=str(files["material"]))
    assert again.base.gap.critical_um.range == (8.0, 10.0)
    assert (again.material.removal_mm3_J.value, again.material.removal_mm3_J.range) == (5e-2, None)


@pytest.mark.parametrize(("share", "half", "said"), [
    (0.5, 0.2, ""), (0.1, 0.2, "interval cut off at the range's lower end"),
    (0.9, 0.2, "interval cut off at the range's upper end"),
    (0.4, 0.7, "interval cut off at the range's lower and upper end"),
    (1.0, 0.2, "at the end of its range; interval cut off at the range's upper end"),
])  # fmt: skip
def test_what_ends_at_a_bound_says_so(share, half, said):
    assert remark(share, half) == said


@pytest.mark.slow
def test_an_interrupted_fit_has_shown_its_progress_and_resumes(log_file, monkeypatch, edmsim):
    cuts = iter(range(3))

    def briefly(*_):
        number = next(cuts, None)
        if number != 0:
            time.sleep(0.5)  # those before are reported
        if number is None:
            raise KeyboardInterrupt
        return np.full((10, 5), 0.5)

    monkeypatch.setattr("edmsim.calibration.comparison.simulate", briefly)
    monkeypatch.setattr("edmsim.screen.LINE_EVERY_S", 0.0)
    words = "calibrate", log_file, "--out", log_file.parent / "fitted.toml", "--height", "10"
    first = edmsim(*words)
    assert first.status == INTERRUPTED
    assert "calibrate 1 of some 65 cuts simulated" in first.err
    assert "interrupted; run the same command to resume" in first.err
    assert {file.name for file in log_file.parent.iterdir()} == {"fitted.runs.jsonl", "log.parquet"}
    cuts = iter(range(1))
    assert "calibrate 4 of some 65 cuts simulated" in edmsim(*words).err


def test_a_log_that_tells_no_settings_is_compared_at_the_usual_ones(compared):
    machine, resolution, said = compared(None, "--height", 10, "--wire", "copper", "--generator", "iso-pulse")
    assert (machine, resolution) == (edmsim.Machine.load(wire="copper", height_mm=10.0), "fast")
    assert said.splitlines() == [
        "edmsim: the log does not name its set-up; assumed: machine agiecut-dem15, material tool-steel",
        "edmsim: interrupted; run the same command to resume",
    ]
