"""`edmsim check`, and messages about options: one line for bad usage, and the names that an option accepts."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import ezdxf
import ezdxf.units
import numpy as np
import pyarrow.parquet as pq
import pytest

from edmsim import controllers, models
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.controllers.planner.registry import PLANNERS
from edmsim.errors import InputError
from edmsim.job.options import CutSettings
from edmsim.job.plan import check, greatest_feed_um_s, lines_of, make_controller, with_passes
from edmsim.machine.machine import Machine
from edmsim.machine.technology import technology_for
from edmsim.recording.figures.profile import path_figure

EXAMPLES = Path(__file__).parents[1] / "examples"
TABLE = EXAMPLES / "positioner" / "table.cnf", EXAMPLES / "positioner" / "table.mod"
PROGRAMS = sorted(
    file for folder in (EXAMPLES, EXAMPLES / "dialects") for file in folder.iterdir()
    if file.suffix in (".ngc", ".nc", ".iso", ".dxf")
)  # fmt: skip


@pytest.fixture(autouse=True)
def empty_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_a_program_is_drawn_with_its_figures(edmsim, tmp_path):
    outcome = edmsim("check", EXAMPLES / "gear.dxf")
    assert (outcome.status, outcome.err) == (0, "")
    assert re.search(r"^contour 2 +closed, 7\.000 x 7\.000 mm", outcome.out, re.MULTILINE)
    assert "24 sharp inner corners" in outcome.out
    assert "at least 24 min" in outcome.out
    assert [str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*.*")] == ["out/gear/path.png"]


@pytest.mark.slow
def test_a_look_compiles_nothing(tmp_path):
    """A user who checks a program or mistypes a name does not wait for the compiler."""
    both = (
        "import sys\nfrom edmsim.cli.app import main\n"
        f"for words in (['check', {str(EXAMPLES / 'punch.ngc')!r}], ['cut', 'no-such.ngc', '--drive', 'uhu']):\n"
        "    sys.argv = ['edmsim', *words]\n"
        "    try:\n        main()\n    except SystemExit as left:\n        print(words[0], left.code)\n"
    )
    config = os.environ.get("MPLCONFIGDIR", str(Path.home() / ".config" / "matplotlib"))
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "MPLCONFIGDIR": config}
    done = subprocess.run(
        [sys.executable, "-c", both], cwd=tmp_path, env=environment, check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    assert done.stdout.endswith(b"check 0\ncut 2\n")
    (sources,) = (tmp_path / "cache" / "edmsim" / "compiled").iterdir()
    assert list(sources.rglob("*.nb*")) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draw", "size"),
    [
        (lambda space: space.add_circle((3.3, 4), 1.0), "2.000 x 2.000"),
        (lambda space: space.add_circle((0, 0), 7.31), "14.620 x 14.620"),
        (lambda space: space.add_ellipse((0, 0), (2.0, 2.0), 0.5), "4.472 x 4.472"),
        (lambda space: space.add_lwpolyline([(0, 0), (4, 0, 0, 0, 1), (4, 2), (0, 2, 0, 0, 1)], close=True),
         "6.000 x 2.000"),
        (lambda space: space.add_lwpolyline([(0, 0), (4, 0), (2, 3.1)], close=True), "4.000 x 3.100"),
        (lambda space: space.add_open_spline([(0, 0), (3, 1e-2), (6, 0), (3, 4), (0, 0)], 1),
         "6.000 x 4.000"),
    ],
)  # fmt: skip
def test_the_size_is_that_of_the_drawing_not_of_its_chords(edmsim, tmp_path, draw, size):
    drawing = ezdxf.new(units=ezdxf.units.MM)
    draw(drawing.modelspace())
    drawing.saveas(tmp_path / "part.dxf")
    assert f"closed, {size} mm" in edmsim("check", tmp_path / "part.dxf").out


@pytest.mark.slow
def test_unknown_words_are_listed_with_everything_else(edmsim, tmp_path):
    program = tmp_path / "words.ngc"
    program.write_text("O12\nG92 X0 Y0\nG41 D1 G1 X5\nM77\nY5 M91\nX9.5\nY0\nX5 M91\nM2\n")
    outcome = edmsim("check", program, "--out", tmp_path / "path.svg")
    assert outcome.status == 2
    assert outcome.err.splitlines() == [
        f"edmsim: {program}:4: unknown word M77",
        f"edmsim: {program}:5: unknown word M91, 2 times",
        "edmsim: the rest is shown without them, as with --ignore M77,M91",
    ]
    assert "offset register D1" in outcome.out
    assert (tmp_path / "path.svg").read_bytes().startswith(b"<?xml")


def test_words_of_a_dialect_say_whose_they_are(edmsim, tmp_path):
    program = tmp_path / "words.ngc"
    program.write_text("G21 G90 G92 X-2. Y0\nG42 G1 X0 Y0\nX5.\nE1221\nY5.\nX0\nY0\nG40 X-2.\nM2\n")
    for command in ("check", "cut"):
        assert "; known to --dialect mitsubishi or skd2\n" in edmsim(command, program).err


@pytest.mark.parametrize("group", [(), ("measure",), ("sweep",), ("console",), ("tune",)])
def test_a_group_of_commands_without_one_shows_its_help(edmsim, group):
    outcome = edmsim(*group)
    assert (outcome.status, outcome.err) == (2, "")
    options = "[OPTIONS]" if group else "[--version | --help]"
    assert f"Usage: {' '.join(('edmsim', *group, options))} COMMAND" in outcome.out
    assert "Usage: edmsim validate [OPTIONS]" in edmsim("validate", "--help").out


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_every_example_can_be_planned(program):
    length, unit = dict(lines_of(check(program, CutSettings())))["path"].split()[:2]
    assert float(length) > 10.0
    assert unit == "mm"


def test_words_that_may_decide_the_contour_are_not_left_out_for_a_look(edmsim, tmp_path):
    program = tmp_path / "words.ngc"
    program.write_text("G92 X0 Y0\nG1 X5.5 V3 M77\nG68\nX9\nM2\n")
    outcome = edmsim("check", program)
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.err.splitlines()[-1] == "edmsim: V3, G68 may decide the contour: correct or delete them"
    assert not list(tmp_path.rglob("*.png"))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("check", EXAMPLES / "gear.dxf", "--out", "path.bmp"), "path.bmp: a figure is written as .pdf .svg .png"),
        (("cut", "no-such.ngc"), "no-such.ngc: no such file"),
        (("cut", EXAMPLES / "make_gear.py"), "make_gear.py: unknown suffix '.py': give G-code (.ngc"),
        (("cut", "a.ngc", "--traces", "a.csv"), "a.csv: a file of traces is written as .parquet"),
        (("measure", "table", "--out", "a.txt"), "a.txt: a compensation file is written as .toml"),
        (("cut", "a.ngc", "--colour", "red"), "no such option: --colour"),
        (("cut",), "missing argument 'program'; see edmsim cut --help"),
        (("cut", "a.ngc", "--height", "tall"), "invalid value for '--height'"),
        # an unset variable of the shell; an empty path would be the current folder
        (("cut", "a.ngc", "--out", ""), "--out is empty: give a value, or leave it out"),
        (("cut", "a.ngc", "--out="), "--out is empty"), (("report", ""), "an argument is empty"),
        (("sweep", "run", "a.ngc", "--out", "a", "--height", ""), "--height is empty"),
        (("saw",), "no such command 'saw'; see edmsim --help"), (("report",), "missing argument"),
        (("bench", "extra"), "extra"),
        (("bench", "--pairs", "3"), "give the revision with --against"),
        (("evaluate", "edmsim/GapFeed-v2", "--write-card"), "give the policy with --policy"),
        (("evaluate", "--policy", "best"), "there is no policy 'best'"),
        (("evaluate", "edmsim/GapFeed-v2", "--policy", "a.json"), "others by --controllers policy:a.json"),
        (("evaluate", "--policy", "GapFeed-ppo", "--page", "a.md"), "--page is for environments"),
        (("evaluate", "edmsim/GapFeed-v2", "--leaderboard", "a.csv"), "a leaderboard is written as .jsonl"),
        (("evaluate", "edmsim/GapFeed-v2", "--page", "page.html"), "page.html: a page is written as .md"),
        (("evaluate", "edmsim/GapFeed-v2", "--controllers", "pid"), "there is no feed controller 'pid'"),
        (("evaluate", "edmsim/GapFeed-v2", "--controllers", "a/p.json"), "did you mean 'policy:a/p.json'?"),
        (("report", "a", "--seconds", "3"), "give the file with --film"),
        (("report", "."), "report.json: no such file, the folder of a finished cut is needed"),
        (("view",), "directory"), (("view", "."), "no cut.rrd in it"), (("view", "none"), "none: no such folder"),
        (("bench", "--figure", "a.jpg"), "a.jpg: a figure is written as .pdf .svg .png"),
        (("bench", "--against", "no-such-revision"), "has no revision 'no-such-revision'"),
        (("tune", "controller", "mcu", "--out", "new"), "no gains of 'mcu' are searched"),
        (("report", "a", "--format", "svg"), "give the folder with --figures"),
        (("tune", "technology", "tool-steel", "--out", "a.txt"), "a technology is written as .toml"),
        (("console", "positioner", *TABLE, "--press", "start=1:2", "--seconds", "0.5"), "there is no input 'start'"),
        (("cut", EXAMPLES / "punch.ngc", "--tab", "1"), "a tab is for passes"),
        (("cut", EXAMPLES / "punch.ngc", "--after-tab", "cut"), "what is done before a tab is for passes"),
        (("check", EXAMPLES / "punch.ngc", "--passes", "1", "--tab", "3"), "a tab is for passes: give more than one"),
        (("check", EXAMPLES / "gear.dxf", "--layers", "a", "--layers", "b"), "--layers appears twice: write"),
        (("check", EXAMPLES / "punch.ngc", "--passes", "3", "--height", "25.4", "--material", "graphite"),
         "no technology for graphite, and the settings of 'cemented-carbide with"),
        (("cut", EXAMPLES / "punch.ngc", "--height-at", "5;30"), "as 12.5:30, not '5;30'"),
        (("cut", EXAMPLES / "punch.ngc", "--peak-current", "3", "--resistance", "20"), "both given"),
        (("cut", EXAMPLES / "punch.ngc", "--pulse-shape", "sine"), "rectangle, triangle"),
        (("cut", EXAMPLES / "punch.ngc", "--flushing-upper", "nan"), "upper nozzle nan Pa"),
        (("cut", EXAMPLES / "punch.ngc", "--material", "new\nline"), "new"),
        (("cut", EXAMPLES / "punch.ngc", "--machine", "mine.toml"), "mine.toml: no such file"),
        (("cut", EXAMPLES / "punch.ngc", "--machine", "production-400"), "the planner exact has no such limit"),
        (("cut", EXAMPLES / "punch.ngc", "--taper-deg", "45"), "give less than 45 either way"),
    ],
)
def test_bad_usage_is_one_line(edmsim, tmp_path, arguments, named):
    outcome = edmsim(*arguments)
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.err.startswith("edmsim: ")
    assert outcome.err.count("\n") == 1
    assert named in outcome.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "value", "hint"),
    [
        ("--machine", "prodction", "did you mean 'production'?"),
        ("--material", "toolsteel", "did you mean 'tool-steel'?"),
        ("--wire", "brss-250", "did you mean 'brass'?"), ("--wire", "brass-0.25", "0.25 mm are 250 um"),
        ("--wire", "copper-.1", "0.1 mm are 100 um"), ("--generator", "isopulse", "did you mean 'iso-pulse'?"),
        ("--controller", "voltge", "did you mean 'voltage'?"), ("--controller", "counts:patience=1", "'patience_s'?"),
        ("--planner", "sine_table", "did you mean 'sine-table'?"), ("--drive", "servo_module", "'servo-module'?"),
        ("--resolution", "FINE", "did you mean 'fine'?"), ("--mechanics", "modl", "did you mean 'modal'?"),
        ("--constant", "wire.strenth_MPa=1", "did you mean 'wire.strength_MPa'?"),
        ("--offset", "156", "156 um are 0.156 mm"), ("--offset", "130.5", "130.5 um are 0.1305 mm"),
    ],
)  # fmt: skip
def test_a_near_miss_gets_a_hint(edmsim, option, value, hint):
    outcome = edmsim("cut", EXAMPLES / "punch.ngc", option, value)
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert outcome.err.endswith(f"{hint}\n")


@pytest.mark.parametrize(
    ("option", "value"),
    [("--machine", "lathe"), ("--wire", "brass-900"), ("--wire", "brass-0.001"), ("--offset", "1e9")],
)
def test_what_is_like_nothing_gets_no_hint(edmsim, option, value):
    outcome = edmsim("cut", EXAMPLES / "punch.ngc", option, value)
    assert outcome.status == 2
    assert "did you mean" not in outcome.err
    assert "um are" not in outcome.err
    assert "mm are" not in outcome.err


def test_offsets_of_a_file_in_um_get_a_hint(edmsim, tmp_path):
    (tmp_path / "offsets.toml").write_text("D1 = 156\n")
    outcome = edmsim("cut", EXAMPLES / "punch.ngc", "--offsets", "offsets.toml")
    assert outcome.err == "edmsim: offsets.toml: the offset D1 is 156: give 0 to 10 mm; 156 um are 0.156 mm\n"


@pytest.mark.slow
def test_a_cut_goes_to_a_folder_of_its_program_and_its_traces_to_a_file(edmsim, tmp_path, small_punch):
    outcome = edmsim(
        "cut", small_punch, "--height", 5, "--resolution", "fast", "--max-time", 0.3,
        "--traces", "kept/traces.parquet",
    )  # fmt: skip
    assert outcome.status == 3
    assert f"Written to {Path('out') / 'small'}" in outcome.out
    assert (tmp_path / "out" / "small" / "report.json").is_file()
    samples = pq.read_table(tmp_path / "kept" / "traces.parquet")
    assert samples.num_rows > 0
    assert (np.diff(samples["window_t_s"].to_numpy()) >= 0).all()


def test_help_and_refusals_list_what_a_registry_has(edmsim, monkeypatch):
    monkeypatch.setitem(PLANNERS, "a-new-one", PLANNERS["dda"])
    assert "a-new-one" in edmsim("cut", "--help").out
    assert "a-new-one" in edmsim("console", "1982", "--help").out
    assert "a-new-one" in edmsim("check", EXAMPLES / "gear.dxf", "--planner", "unknown").err
    assert "lead-oracle" in edmsim("evaluate", "--help").out  # it reads the true gap, so it cannot cut
    assert "lead-oracle" not in edmsim("cut", "--help").out


def test_what_is_listed_of_controllers_can_be_cut_with_and_what_is_not_is_refused(tmp_path):
    own = tmp_path / "own.py"
    own.write_text("from edmsim.controllers.feed.laws import FixedController as Own\n", encoding="utf-8")
    filled = {"policy:FILE": "policy:GapFeed-ppo", "own.py:Own": f"{own}:Own"}
    cuts, all_of_them = controllers.choices(cutting=True), controllers.choices()
    for text in cuts:
        assert make_controller(filled.get(text, text))
    for text in set(all_of_them) - set(cuts):
        with pytest.raises(InputError, match="cut with another"):
            make_controller(text)
    listed = re.escape(", ".join(cuts))
    with pytest.raises(InputError, match=f"'genius'; choose one of {listed}$"):
        make_controller("genius")
    with pytest.raises(InputError, match=f"'genius'; choose one of {re.escape(', '.join(all_of_them))}$"):
        controllers.from_text("genius")


def test_the_least_time_is_that_of_the_path_at_the_greatest_feed(small_punch):
    found = check(small_punch, CutSettings(height_mm=5.0))
    simulation = Simulation(found.machine, found.path, controllers.make("counts"), resolution="fast")
    assert found.limited_by == "machine"
    assert found.feed_um_s == simulation.max_feed_um_s
    assert found.least_s == pytest.approx(simulation.total_um / simulation.max_feed_um_s)
    assert found.path_length_mm == pytest.approx(simulation.total_um * 1e-3)
    faster = {"machine": "production", "height_mm": 3.0}
    held, freed = (check(small_punch, CutSettings(**faster, planner=name)) for name in ("poscal", "exact"))
    assert (held.limited_by, held.feed_um_s) == ("planner", MAX_FEED_UM_S)
    assert (freed.limited_by, freed.feed_um_s) == ("machine", 400.0)


def test_a_wire_that_stays_is_not_threaded_and_trims_are_not_limited_by_the_generator():
    folder, usual = EXAMPLES / "dialects", {"machine": "production", "generator": "production", "wire": "brass-250"}
    conditions = str(folder / "conditions.toml")
    found = check(folder / "punch-sodick.nc", CutSettings(**usual, planner="exact", conditions=conditions))
    profile, tab = found.path.contours
    distance_um = np.hypot(*(tab.passes[0].points_um[0] - profile.passes[-1].points_um[-1]))
    assert (found.waiting_s, tab.continues) == (0, True)
    assert found.path_length_mm * 1e3 == pytest.approx(profile.length_um + tab.length_um + distance_um)
    trims_um = sum(p.wire_path.along_um[-1] for k in (profile, tab) for p in k.passes if p.number > 1)
    rough_s = (found.path_length_mm * 1e3 - trims_um) / found.feed_um_s
    assert (found.limited_by, found.trim_feed_um_s) == ("generator", 400.0)
    assert found.least_s == pytest.approx(rough_s + trims_um / 400.0)
    assert dict(lines_of(found))["time"].endswith(f"{found.feed_um_s:.1f} µm/s, 400.0 µm/s in trims")


def test_the_time_is_that_of_the_lowest_height_and_the_offset_that_of_the_constants(edmsim, small_punch):
    options = ("--height", 400, "--constant", "dielectric.side_gap_um=40")
    times = [edmsim("check", small_punch, *options, *more).out for more in ((), ("--height-at", "1:20"))]
    assert ["all that the generator can remove" in time for time in times] == [True, False]
    assert all("0.165 mm" in time for time in times)
    assert "cannot change at 99 mm" in edmsim("check", small_punch, "--height-at", "99:10").err


def test_a_tall_workpiece_is_limited_by_the_generator():
    machine = Machine.load(height_mm=400.0)
    feed_um_s, limited_by = greatest_feed_um_s(machine, "poscal", 400.0)
    assert limited_by == "generator"
    # the volume that all pulses remove in a second is that of the kerf cut in it
    removed_mm3 = 6.61 * 0.3 * machine.material.burning_voltage_V.value * machine.material.removal_mm3_J.value
    assert feed_um_s * 1e-3 * 400.0 * 2 * machine.auto_offset_mm == pytest.approx(removed_mm3, rel=1e-3)
    assert greatest_feed_um_s(machine, "poscal", 200.0)[0] == pytest.approx(2 * feed_um_s)


def test_passes_are_listed_as_the_program_has_them(edmsim):
    found = edmsim("check", EXAMPLES / "dialects" / "punch-sodick.nc")
    assert (found.status, found.err) == (0, "")
    rows = found.out.splitlines()
    assert rows[0] == "line 33     open, 29.141 mm, wire on the left by 0.195 mm, C001 after C000"
    assert rows[2].endswith("C003 after C002, on the same wire, then a stop")
    assert rows[6].startswith("contour 1")
    names = [row.split("  ")[0] for row in rows if not row.startswith("note")]
    assert len(set(names)) == len(names)  # rows of the program and of the planned path have different names


def test_the_dialect_and_the_conditions_are_options_of_check(edmsim):
    dialects = EXAMPLES / "dialects"
    found = edmsim("check", dialects / "punch-freecad.nc", "--dialect", "iso")
    assert found.status == 0
    assert "note: dialect iso" in found.out
    found = edmsim("check", dialects / "punch-freecad.nc", "--dialect", "sodic")
    assert "did you mean 'sodick'" in found.err
    leans = edmsim(
        "check", dialects / "cone-fanuc.nc", "--dialect", "fanuc", "--conditions", dialects / "conditions.toml"
    )
    assert "the condition S1 is not in the table of conditions: there are C0, C1, C2, C3" in leans.err


def test_passes_are_estimated_by_their_technology():
    found = check(EXAMPLES / "punch.ngc", CutSettings(passes=3, height_mm=25.4))
    assert [one.number for one in found.passes] == [1, 2, 3]
    assert [one.offset_mm for one in found.passes] == sorted((one.offset_mm for one in found.passes), reverse=True)
    assert found.passes[0].seconds > found.passes[1].seconds  # the rough pass is the slowest
    assert found.expected_s == pytest.approx(sum(one.seconds for one in found.passes))
    table, rough = technology_for("tool-steel").table(25.4, 3), found.path.contours[0].passes[0]
    lead_mm = np.hypot(*np.diff(rough.points_um[: rough.approach_moves + 1], axis=0).T).sum() * 1e-3
    for one, setting in zip(found.passes, table.settings, strict=True):
        slower_mm = lead_mm * (1 / table.approach_share - 1) if one.number == 1 else 0.0
        assert one.seconds == pytest.approx(60 * (one.length_mm + slower_mm) / setting.found.feed_mm_min)
    shifted = check(EXAMPLES / "punch.ngc", CutSettings(passes=3, height_mm=25.4, offset=0.2)).passes
    by_mm = [one.offset_mm - before.offset_mm for before, one in zip(found.passes, shifted, strict=True)]
    assert by_mm == pytest.approx([0.2 - found.passes[-1].offset_mm] * 3)  # the offset of the last pass is set
    outcome = dict(lines_of(found))
    assert outcome["pass 3"].startswith(f"offset {found.passes[2].offset_mm:.3f} mm, ")
    assert "time" not in outcome  # the least time is that of one pass at the rough setting
    drawn = path_figure(found.path, "punch", 300.0).axes[0].get_lines()
    assert [f"pass {one.number}, {one.offset_mm:.3f} mm" for one in found.passes] == [
        str(line.get_label()) for line in drawn if str(line.get_label()).startswith("pass ")
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names of files are UTF-8")
def test_a_program_whose_name_is_not_utf_8_is_drawn(edmsim, tmp_path):
    program = tmp_path / "pr\udcf6gram.ngc"
    shutil.copy(EXAMPLES / "punch.ngc", program)
    assert edmsim("check", program, "--out", tmp_path / "path.png").status == 0
    assert (tmp_path / "path.png").stat().st_size > 1000


def test_what_a_technology_leaves_open_holds_in_every_pass():
    settings = CutSettings(passes=3, height_mm=25.4, standoff_lower_mm=2.0, constants=["gap.critical_um=4"])
    machines = [one.machine for one in with_passes(EXAMPLES / "punch.ngc", settings).setups]
    assert len({machine.t_period_us for machine in machines}) > 1
    for machine in machines:
        assert (machine.standoff_lower_mm, machine.base.gap.critical_um.value) == (2.0, 4.0)


def test_a_single_pass_is_estimated_like_the_rough_one_of_several():
    (one,) = check(EXAMPLES / "punch.ngc", CutSettings(passes=1, height_mm=25.4)).passes
    rough = check(EXAMPLES / "punch.ngc", CutSettings(passes=2, height_mm=25.4)).passes[0]
    assert one.offset_mm == technology_for("tool-steel").table(25.4, 1).offsets_mm[0]
    assert one.length_mm == pytest.approx(rough.length_mm, rel=0.05)
    assert one.seconds == pytest.approx(rough.seconds, rel=0.2)


@pytest.mark.parametrize("technology", [None, "tool-steel-brass-254"])
def test_a_wire_of_nearly_the_same_size_takes_the_technology_with_its_own_radius(technology):
    found = {
        wire: with_passes(
            EXAMPLES / "punch.ngc", CutSettings(passes=3, height_mm=25.4, wire=wire, technology=technology)
        ) for wire in ("brass-254", "brass-250", "brass-255")
    }  # fmt: skip
    offsets_um = {wire: [one.offset_um for one in passes.path.contours[0].passes] for wire, passes in found.items()}
    assert offsets_um["brass-250"] == [um - 2 for um in offsets_um["brass-254"]]
    assert offsets_um["brass-255"] == offsets_um["brass-254"]
    thin = found["brass-250"]
    assert {one.machine.wire_diameter_um for one in thin.setups} == {250.0}
    assert thin.settings.wire == "brass-250"
    notices = {wire: [text for text in passes.path.notices if "brass" in text] for wire, passes in found.items()}
    settings = "the settings of the passes are those for the wire brass-254; with"
    assert notices["brass-254"] == []
    assert notices["brass-250"] == [f"{settings} brass-250 their offsets are 2 um smaller, as its radius is"]
    assert notices["brass-255"] == [f"{settings} brass-255 their offsets are the same"]
    for other in ("brass-200", "zinc-coated-brass-254"):
        with pytest.raises(InputError, match=f"{other}|sets wire to 'brass-254'"):
            with_passes(EXAMPLES / "punch.ngc", CutSettings(passes=3, wire=other, technology=technology))


def test_passes_in_a_material_without_a_technology_say_what_they_take_and_what_to_run(tmp_path):
    found = check(EXAMPLES / "punch.ngc", CutSettings(material="copper", passes=3, height_mm=25.4))
    (outcome,) = [notice for notice in found.path.notices if "technology" in notice]
    assert outcome.startswith("there is no technology for copper: the passes take the settings of 'tool-steel ")
    assert "edmsim tune technology copper --height 25.4 --passes 3 --out copper-passes.toml" in outcome
    bronze = tmp_path / "bronze.toml"
    bronze.write_text(models.path("materials/copper.toml").read_text(encoding="utf-8"), encoding="utf-8")
    found = check(EXAMPLES / "punch.ngc", CutSettings(material=str(bronze), passes=3, height_mm=25.4))
    (outcome,) = [notice for notice in found.path.notices if "technology" in notice]
    assert f"tune technology {bronze} --height 25.4 --passes 3 --out bronze-passes.toml" in outcome
    own = check(EXAMPLES / "punch.ngc", CutSettings(material="aluminium", passes=3, height_mm=25.4))
    assert not any("technology" in notice for notice in own.path.notices)
    fast = check(EXAMPLES / "punch.ngc", CutSettings(passes=3, height_mm=25.4, resolution="fast"))
    (moved,) = [notice for notice in fast.path.notices if "technology" in notice]
    assert moved.startswith("the offsets of the passes were measured at the resolution default; at fast walls lie")
    assert own.passes[0].seconds < found.passes[0].seconds  # aluminium is cut about twice as fast in practice


@pytest.mark.parametrize(("key", "value", "reason"), [
    ("machine", '"nope"', "unknown machine 'nope'"), ("wire", '"nope"', "unknown wire 'nope'"),
    ("planner", '"nope"', "there is no planner 'nope'"), ("generator", '"nope"', "unknown generator 'nope'"),
    ("t_on_us", "5000.0", "t_on 5000 us is not within"),
])  # fmt: skip
def test_a_technology_that_cannot_be_used_is_refused_by_its_file(tmp_path, key, value, reason):
    ours = (Path(models.__file__).parent / "technologies" / "tool-steel-brass-254.toml").read_text(encoding="utf-8")
    file = tmp_path / "own.toml"
    file.write_text(re.sub(f"^{key} = .*", f"{key} = {value}", ours, count=1, flags=re.MULTILINE), encoding="utf-8")
    settings = CutSettings(passes=2, height_mm=25.4, technology=str(file))
    with pytest.raises(InputError, match=f"^{re.escape(str(file))}: {reason}"):
        check(EXAMPLES / "punch.ngc", settings)
