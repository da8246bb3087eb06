"""The command line: exit statuses, one clear line for bad input, and nothing left half-written."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from edmsim import __version__, models
from edmsim.__main__ import main
from edmsim.bench import profile
from edmsim.calibration import read_log
from edmsim.cli import app as cli
from edmsim.closed_loop.simulation import Simulation
from edmsim.errors import INTERRUPTED, InputError
from edmsim.job.cut import CHECKPOINT, CutProgress
from edmsim.job.options import CutSettings
from edmsim.learning import policy_file
from edmsim.learning import score as scoring
from edmsim.plant.window import WireLostError
from edmsim.recording import report as report_module
from edmsim.screen import ShownProgress
from edmsim.signals import raise_again

from .conftest import FILES

FAST = ("--height", "5", "--resolution", "fast")


def test_help_fits_one_screen_and_names_every_command(edmsim, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = edmsim("--help")
    assert shown.status == 0
    assert len(shown.out.splitlines()) <= 24
    for name in (*cli.COMMANDS[""][1], *(group for group in cli.COMMANDS if group)):
        assert re.search(rf"^│ {name} +[A-Z]", shown.out, re.MULTILINE), name


def test_version(edmsim):
    assert edmsim("--version") == (0, __version__ + "\n", "")


def test_drawing_software_that_mujoco_cannot_load_is_refused_in_one_line(tmp_path):
    program = Path(__file__).parents[1] / "examples/slot.iso"
    command = [sys.executable, "-m", "edmsim", "cut", str(program), "--out", str(tmp_path / "out")]
    env = {**os.environ, "MUJOCO_GL": "none"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("edmsim: MuJoCo cannot be loaded with MUJOCO_GL=none: unset this variable, or set")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_finished_cut_reports_and_exits_0(tmp_path, edmsim):
    program, out = tmp_path / "line.ngc", tmp_path / "a" / "b"
    program.write_text("G0 X0 Y0\nG1 X0.2\nM2\n")
    outcome = edmsim("cut", program, "--out", out, "--offset", "none", "--seed", 4, *FAST)
    assert outcome.status == 0
    assert outcome.out.startswith("finished")
    assert f"edmsim view {out}" in outcome.out
    assert "100.0 %" in outcome.err
    report = json.loads((out / "report.json").read_text())
    assert (report["outcome"], report["seed"], report["settings"]["height_mm"]) == ("finished", 4, 5.0)
    # without offset the wire's centre follows the drawing: no edge, no error, no better offset
    assert report["profile_error_um"]["max"] is None
    assert (report["offset"]["mean_error_um"], report["offset"]["to_use_mm"]) == (None, None)
    assert re.search(r"^profile error +not measured", outcome.out, re.MULTILINE)
    assert "use --offset" not in outcome.out


@pytest.mark.slow
def test_every_option_reaches_the_cut(small_punch, tmp_path, edmsim):
    edmsim("cut", small_punch, "--out", tmp_path, "--quiet", "--max-time", 0.1, "--height", 7, "--resolution", "fast",
           "--material", "copper", "--wire", "molybdenum-150", "--tension", 9, "--generator", "ignition-pulse",
           "--t-on", 15, "--t-period", 120, "--controller", "fixed:feed_um_s=11", "--planner", "dda", "--offset",
           "0.1", "--seed", 12, "--machine", "agiecut-dem15",
           "--mechanics", "modal", "--height-at", "1:5", "--height-at", "2.5:6.5", "--open-voltage", 200,
           "--peak-current", 5, "--ignition-wait", 30, "--pulse-shape", "triangle", "--wire-speed", 0.15,
           "--flushing-lower", 0, "--flushing-upper", 1e5, "--standoff-lower", 3,
           "--standoff-upper", 0.4)  # fmt: skip
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["seed"] == 12
    assert report["settings"].items() >= {
        "max_time_s": 0.1, "height_mm": 7.0, "heights": [[1.0, 5.0], [2.5, 6.5]], "resolution": "fast",
        "material": "copper", "wire": "molybdenum-150", "wire_diameter_um": 150.0, "tension_N": 9.0,
        "generator": "ignition-pulse", "t_on_us": 15.0, "t_period_us": 120.0,
        "controller": "fixed:feed_um_s=11", "planner": "dda", "offset_um": 100.0, "open_voltage_V": 200.0,
        "peak_current_A": 5.0, "resistance_ohm": None, "ignition_wait_us": 30.0, "pulse_shape": "triangle",
        "wire_speed_m_s": 0.15, "flushing_lower_Pa": 0.0, "flushing_upper_Pa": 1e5,
        "standoff_lower_mm": 3.0, "standoff_upper_mm": 0.4,
    }.items()  # fmt: skip
    made_with = CutSettings.of_report(report).load_machine()
    assert made_with.with_(peak_current_A=None, resistance_ohm=50.0).flushing_lower_Pa == 0.0
    read_back = read_log(str(tmp_path / "windows.parquet")).settings
    assert read_back.load_machine() == made_with


@pytest.mark.slow
def test_quiet_prints_nothing(small_punch, tmp_path, edmsim):
    assert edmsim("cut", small_punch, "--out", tmp_path, "--max-time", 0.1, "--quiet", *FAST) == (3, "", "")


def assert_refused(outcome, *named):
    assert outcome.status == 2
    assert outcome.out == ""
    assert outcome.err.startswith("edmsim: ")
    assert outcome.err.endswith("\n")
    assert outcome.err.count("\n") == 1, outcome.err
    for text in named:
        assert text in outcome.err, outcome.err


@pytest.mark.parametrize("below", ["", "a", "a/b"])
def test_output_folder_that_cannot_be(small_punch, tmp_path, edmsim, below):
    (tmp_path / "file").write_text("kept")
    out = tmp_path / "file" / below
    assert_refused(edmsim("cut", small_punch, "--out", out, *FAST), str(out), "output folder")
    assert [f.name for f in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_output_folder_without_permission(small_punch, tmp_path, edmsim):
    tmp_path.chmod(0o500)
    assert_refused(edmsim("cut", small_punch, "--out", tmp_path, *FAST), str(tmp_path), "output folder")


def test_bad_input_leaves_an_earlier_cut_alone(small_punch, tmp_path, edmsim):
    (tmp_path / "report.json").write_text("earlier")
    assert edmsim("cut", small_punch, "--out", tmp_path, "--planner", "straight").status == 2
    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [("report.json", "earlier")]


@pytest.mark.slow
def test_a_film_is_one_of_the_files_of_a_cut(small_cut, tmp_path, edmsim):
    shown = edmsim("report", small_cut.folder, "--film", tmp_path / "cut.gif", "--seconds", "0.5", "--contour",
                   tmp_path / "cut.csv")  # fmt: skip
    assert shown.status == 0
    assert shown.out.split() == [str(tmp_path / "cut.gif"), str(tmp_path / "cut.csv")]
    assert (tmp_path / "cut.gif").read_bytes()[:3] == b"GIF"
    assert_refused(edmsim("report", small_cut.folder, "--film", tmp_path / "cut.txt"), ".mp4 .gif")
    assert_refused(edmsim("report", tmp_path, "--film", tmp_path / "a.gif"), str(tmp_path), "cut.rrd")


@pytest.mark.slow
def test_interrupted_cut_is_taken_up_again(small_punch, tmp_path, edmsim, monkeypatch):
    calls = []

    def interrupted(self, progress):
        calls.append(progress)
        if len(calls) == 10:
            raise KeyboardInterrupt

    command = ("cut", small_punch, "--out", tmp_path, "--quiet", "--max-time", 0.5, *FAST)
    with monkeypatch.context() as patch:
        patch.setattr(CutProgress, "show", interrupted)
        outcome = edmsim(*command)
    assert (outcome.status, outcome.out) == (130, "")
    assert outcome.err.count("\n") == 1
    assert "--resume" in outcome.err
    assert [f.name for f in tmp_path.iterdir()] == [CHECKPOINT]
    assert edmsim(*command, "--resume").status == 3
    assert json.loads((tmp_path / "report.json").read_text())["pulses"] == 20 * 255


@pytest.mark.slow
@pytest.mark.usefixtures("signals")
@pytest.mark.parametrize("late", ["checkpoint", "bar", "table"])
def test_an_interrupt_when_all_is_written_ends_nothing(small_punch, tmp_path, edmsim, monkeypatch, late):
    """Before and after the cut's own handler is removed, and while the results are shown."""
    def interrupted(where, name):
        before = getattr(where, name)

        def behind(*arguments, **named):
            done = before(*arguments, **named)
            if name != "unlink" or arguments[0].name == CHECKPOINT:
                signal.raise_signal(signal.SIGINT)
            return done

        monkeypatch.setattr(where, name, behind)

    interrupted(*{"checkpoint": (Path, "unlink"), "bar": (ShownProgress, "__exit__"),
                  "table": (report_module, "render_table")}[late])  # fmt: skip
    outcome = edmsim("cut", small_punch, "--out", tmp_path, "--max-time", 0.1, *FAST)
    assert outcome.status == 3  # the status of the time limit, as without interrupt
    assert "interrupted" not in outcome.err
    assert sorted(f.name for f in tmp_path.iterdir()) == FILES


@pytest.mark.parametrize("words", [["sweep", "show"], ["console", "servo", "uhu", "--record"], ["sweep", "run"]])
def test_a_name_too_long_for_a_file_is_refused(edmsim, tmp_path, words):
    long = "a" * 300 + ".rrd"
    more = ["--out", tmp_path] if words == ["sweep", "run"] else []
    assert_refused(edmsim(*words, long, *more), "a" * 10)


def test_a_recording_of_a_drive_that_cannot_be_written_is_refused(edmsim, tmp_path):
    (tmp_path / "scope.rrd").symlink_to(tmp_path / "no-such-folder" / "scope.rrd")
    assert_refused(edmsim("console", "servo", "uhu", "--record", tmp_path / "scope.rrd"), "cannot be written")


def test_model_outside_its_validity_is_one_line_and_exit_1(small_punch, tmp_path, edmsim, monkeypatch):
    def fail(simulation):
        window = simulation.plant.advance()
        raise WireLostError("the wire left its guides", 0.0255, simulation.plant.commanded_um, window)

    monkeypatch.setattr(Simulation, "step", fail)
    outcome = edmsim("cut", small_punch, "--out", tmp_path, *FAST)
    assert outcome[:2] == (1, "")
    assert outcome.err.splitlines()[-1] == "edmsim: the wire left its guides"  # after the progress bar


def test_error_stays_on_one_line_in_a_narrow_terminal(tmp_path, edmsim, monkeypatch):
    for name, value in (("COLUMNS", "40"), ("FORCE_COLOR", "1"), ("TERM", "xterm-256color")):
        monkeypatch.setenv(name, value)
    file = tmp_path / "no [bold]such.ngc"
    assert_refused(edmsim("cut", file, "--out", tmp_path / "out"), f"{file}: ")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no device that is always full")
@pytest.mark.parametrize("words", [["--version"], ["gap", "--help"]])
def test_a_full_disk_at_the_standard_output_is_one_line(words):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "edmsim", *words]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False)
    assert done.stderr == b"edmsim: the standard output cannot be written: No space left on device\n"
    assert done.returncode == 1


def test_bench_prints_json_or_a_table(edmsim, monkeypatch):
    figures = {"pulses_per_s": 1_234_567.0, "realtime_factor": 1.234}
    monkeypatch.setattr("edmsim.bench.figures.measure", lambda: figures)
    assert json.loads(edmsim("bench", "--json").out) == figures
    table = edmsim("bench").out
    assert re.search(r"pulses_per_s .* 1,234,567 ", table)
    assert re.search(r"realtime_factor .* 1\.23 ", table)


@pytest.mark.slow
def test_bench_draws_where_a_pulses_time_goes(edmsim, tmp_path, monkeypatch):
    shares = dict.fromkeys(profile.PARTS, 1.0 / len(profile.PARTS))
    monkeypatch.setattr(profile, "profile", lambda _: {"fast": profile.LoopProfile(400.0, 410.0, shares, 1000)})
    outcome = edmsim("bench", "--profile", "--json", "--figure", tmp_path / "new" / "profile.png")
    assert json.loads(outcome.out)["fast"]["ns_per_pulse"] == 400.0
    assert (tmp_path / "new" / "profile.png").read_bytes().startswith(b"\x89PNG")


def test_an_interrupted_comparison_is_one_line_and_130(edmsim, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("edmsim.bench.revisions.compare", interrupted)
    outcome = edmsim("bench", "--against", "HEAD")
    assert (outcome.status, outcome.out) == (130, "")
    assert outcome.err == "edmsim: interrupted; no measurement was completed\n"


@pytest.mark.parametrize("extra", [False, True])
def test_an_import_that_ctrl_c_ends_is_silent_and_130(edmsim, monkeypatch, extra):
    def compiled(*_):
        try:
            raise ImportError("initialization failed") from KeyboardInterrupt()
        except ImportError as error:
            if extra:
                raise InputError("it is not installed") from error
            raise

    monkeypatch.setattr("edmsim.bench.revisions.compare", compiled)
    assert edmsim("bench", "--against", "HEAD") == (130, "", "")


class _Interrupted:
    def __getattr__(self, name):
        raise KeyboardInterrupt


def test_ctrl_c_while_modules_load_is_silent_and_130(capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "edmsim.cli.app", _Interrupted())
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == INTERRUPTED
    assert capfd.readouterr() == ("", "")


def test_ctrl_c_while_the_package_is_imported_is_silent(tmp_path):
    (tmp_path / "gymnasium.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[1])])
    ended = subprocess.run(
        [sys.executable, "-m", "edmsim", "--version"], capture_output=True, check=False,
        env={**os.environ, "PYTHONPATH": path}, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGINT, b"", b"")  # status 130 in shells


class _Gone:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def _leave_one():
    _Gone()
    time.sleep(5.0)


@pytest.mark.usefixtures("signals")
def test_ctrl_c_that_a_destructor_swallows_comes_again(monkeypatch, capfd):
    monkeypatch.setattr(sys, "unraisablehook", raise_again)
    with pytest.raises(KeyboardInterrupt):
        _leave_one()
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.usefixtures("draws_pictures")
def test_report_is_made_again_and_figures_written(small_cut, tmp_path, edmsim):
    outcome = edmsim("report", small_cut.folder, "--figures", tmp_path, "--format", "png")
    assert outcome.status == 0
    assert str(tmp_path / "corner.png") in outcome.out
    assert (tmp_path / "corner.png").read_bytes().startswith(b"\x89PNG")


def test_a_policy_is_scored_again(edmsim, tmp_path, monkeypatch):
    for kind in ("json", "npz"):
        (tmp_path / f"mine.{kind}").write_bytes(models.path(f"policies/GapFeed-ppo.{kind}").read_bytes())
    row = scoring.Score("policy", "fast", 2, 123.25, 1.0, 20.0, None, 60.0, 0, 0)
    monkeypatch.setattr("edmsim.evaluation.compare.run", lambda *_, **__: {"policy:mine": []})
    monkeypatch.setattr(scoring, "score", lambda _, resolution: row._replace(resolution=resolution))
    outcome = edmsim("evaluate", "--policy", tmp_path / "mine.json", "--seeds", 2, "--write-card")
    assert outcome.status == 0
    assert outcome.out.count("123.2") == 3
    scores = policy_file.load(str(tmp_path / "mine.json")).card.scores
    assert [scored["resolution"] for scored in scores] == ["fast", "default", "fine"]
    named = f"policy:{tmp_path / 'mine.json'}"
    at_one = edmsim("evaluate", "--policy", named, "--seeds", 2, "--resolution", "fine", "--json")
    assert [row["resolution"] for row in json.loads(at_one.out)[0]["scores"]] == ["fine"]
    assert_refused(edmsim("evaluate", "--policy", tmp_path / "mine.json", "--seeds", 1), "seeds is 1", "2 or more")
    assert_refused(edmsim("evaluate"), "name an environment, or a policy")
    assert_refused(edmsim("evaluate", "all", "edmsim/GapFeed-v2"), "all names every environment")


def test_a_policy_of_a_shift_is_scored_again_where_its_training_scored_it(edmsim, monkeypatch):
    row = scoring.Score("policy", "fast", 2, 123.25, 1.0, 20.0, None, 60.0, 0, 0)
    monkeypatch.setattr("edmsim.evaluation.compare.run", lambda *_, **__: {"policy:mine": []})
    monkeypatch.setattr(scoring, "score", lambda _, resolution: row._replace(resolution=resolution))
    outcome = edmsim("evaluate", "--policy", "MaxRateShift-adapt", "--seeds", 2, "--json")
    assert [row["resolution"] for row in json.loads(outcome.out)[0]["scores"]] == ["fast"]
