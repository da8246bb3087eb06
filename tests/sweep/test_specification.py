"""A specification: values as a person writes them, the runs they stand for, and what is refused in one line."""

import numpy as np
import pytest

from edmsim import models
from edmsim.errors import InputError
from edmsim.evaluation.episode import HELD_BACK
from edmsim.machine.machine import Machine
from edmsim.runs import digests_of
from edmsim.sweep.specification import Specification, read_specification, runs_of, values_of
from edmsim.user_code import listed


@pytest.mark.parametrize(("written", "meant"), [
    ("5,10,20", [5, 10, 20]), ("10:40:5", [10, 15, 20, 25, 30, 35, 40]), ("0.1:0.3:0.1", [0.1, 0.2, 0.3]),
    ("40:10:-15,3", [40, 25, 10, 3]), (7, [7]), ("counts,policy:gap-feed", ["counts", "policy:gap-feed"]),
    ("counts:short_weight=1,integral_um_s2=9,delay", ["counts:short_weight=1,integral_um_s2=9", "delay"]),
    ("true,false", [True, False]), ("1e5", [1e5]), (["a,b"], ["a,b"]),
    ((5, "b"), [5, "b"]), (np.array([5, 10]), [5, 10]), ([np.float64(0.5)], [0.5]),
])  # fmt: skip
def test_values_are_what_a_person_means(written, meant):
    found = values_of(written, "x")
    assert found == meant
    assert [type(value) for value in found] == [type(value) for value in meant]


def test_a_run_is_known_by_what_decides_its_result(line, short):
    def ids(**changes):
        return [run.id for run in runs_of(Specification(**{"program": str(line), "settings": short, **changes}))]

    same = ids()
    assert ids(settings={**short, "controller": "counts"}) == same  # its default
    assert ids(program=line) == ids(program=[line]) == same  # a path
    assert ids(recordings="windows") == same  # they change nothing in a result
    different = [
        ids(seeds=[1]), ids(settings={**short, "height_mm": 6}), ids(machine_samples=1),
        ids(settings={**short, "gap.critical_um": 5}),
    ]  # fmt: skip
    line.write_text("G21 G90\nG0 X0 Y0\nG1 X0.4\nM2\n")
    assert len({same[0], *(found for (found,) in different)}) == 5
    moved = line.with_name("elsewhere") / line.name
    moved.parent.mkdir()
    moved.write_text("G21 G90\nG0 X0 Y0\nG1 X0.3\nM2\n")
    assert ids(program=str(moved)) == same


def test_options_have_the_names_of_the_command_as_well(line, short):
    grid = {"height-at": "0.1:8,0.2:12", "axis-fault": "x:stuck@1"}
    runs = list(runs_of(Specification(program=str(line), settings=short, grid=grid)))
    assert [[*map(tuple, run.settings["heights"])] for run in runs] == [[(0.1, 8.0)], [(0.2, 12.0)]]
    assert [list(run.settings["axis_faults"]) for run in runs] == [["x:stuck@1"]] * 2


def test_a_run_is_known_by_files_in_lists_and_by_the_mjcf_of_a_machine(line, tmp_path):
    machine, steel, mjcf = (tmp_path / name for name in ("own.toml", "steel.toml", "own.xml"))
    machine.write_text('like = "production"\nmodel = "own.xml"\n')
    steel.write_text(models.path("materials/tool-steel.toml").read_text())
    mjcf.write_text("<mujoco/>")

    def ids():
        of_cut = Specification.model_validate({"program": str(line), "settings": {"machine": str(machine)}})
        of_env = {"environment": "edmsim/GapFeed-v2", "settings": {"materials": [str(steel)]}}
        return [run.id for spec in (of_cut, Specification.model_validate(of_env)) for run in runs_of(spec)]

    before = ids()
    for file in (steel, mjcf):
        file.write_text(file.read_text() + "\n")
    assert not set(before) & set(ids())


def test_a_run_is_known_by_the_modules_in_its_folder_that_a_controller_imports(tmp_path):
    texts = {
        "law.py": "import math\nimport gains\nfrom servo import laws\n", "gains.py": "from shared import FEED\n",
        "shared.py": "import gains\nFEED = 20.0\n", "servo/__init__.py": "", "servo/other.py": "",
        "servo/laws.py": "from .limits import MOST\nfrom . import low\n", "servo/limits/__init__.py": "MOST = 30.0\n",
        "servo/low.py": "import servo.lowest\n", "servo/lowest.py": "", "limits.py": "",
    }  # fmt: skip
    (tmp_path / "servo" / "limits").mkdir(parents=True)
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    before, changed = digests_of([f"{tmp_path}/law.py:Law"]), set()
    for name, text in texts.items():
        (tmp_path / name).write_text(f"{text}LEAST = 1.0\n")
        if digests_of([f"{tmp_path}/law.py:Law"]) != before:
            changed.add(name)
        (tmp_path / name).write_text(text)
    assert changed == texts.keys() - {"servo/other.py", "limits.py"}


def test_a_run_is_known_by_the_machine_that_a_technology_names(line, tmp_path):
    machine, technology = tmp_path / "own.toml", tmp_path / "technology.toml"
    ours = models.path("technologies/tool-steel-brass-254.toml").read_text()
    technology.write_text(ours.replace('machine = "production"', f"machine = '{machine}'"))
    settings = {"passes": 2, "technology": str(technology)}
    found = []
    for title in ("one", "another"):
        machine.write_text(f'like = "production"\ntitle = "{title}"\n')
        found += runs_of(Specification.model_validate({"program": str(line), "settings": settings}))
    assert found[0].id != found[1].id


def test_everything_is_combined_with_everything(line, short):
    spec = Specification(
        program=[str(line)], seeds=2, machine_samples=3, settings=short,
        grid={"t_on": "20:40:10", "gap": {"critical_um": [4, 5]}},
        sobol={"samples": 4, "ranges": {"tension": (8, np.float64(12), "linear"), "gap.deionisation_us": "range",
                                        "wire_speed_m_s": [0.1, 10, "log"]}},
    )  # fmt: skip
    runs = list(runs_of(spec))
    assert len(runs) == len({run.id for run in runs}) == spec.runs == 3 * 2 * 4 * 2 * 3
    assert {run.settings["t_on_us"] for run in runs} == {20.0, 30.0, 40.0}
    points = {(run.settings["tension"], run.settings["wire_speed_m_s"], tuple(run.settings["constants"][1]))
              for run in runs}  # fmt: skip
    assert len(points) == 4
    bounds = Machine.load().uncertain()["gap.deionisation_us"].range
    for tension, speed, (name, value) in points:
        assert name == "gap.deionisation_us"
        assert 8 <= tension <= 12
        assert bounds[0] <= value <= bounds[1]
        assert 0.1 <= speed <= 10
    # each quarter of a range, in its logarithm where that was asked, is met once
    assert sorted(int(4 * (tension - 8) / 4) for tension, _, _ in points) == [0, 1, 2, 3]
    assert sorted(int(2 * np.log10(speed / 0.1)) for _, speed, _ in points) == [0, 1, 2, 3]


def test_a_program_with_passes_of_its_own_has_the_ranges_of_its_technologys_machine(line, tmp_path):
    again = tmp_path / "again.ngc"
    edge = "G41 D{0}\nG1 X0.\nX4.\nG40\n"
    again.write_text(f"D1=0.25\nD2=0.2\nG92 X-1. Y0.\n{edge.format(1)}G1 X-1.\n{edge.format(2)}M2\n")
    sobol = {"samples": 4, "ranges": {"guides.clearance_mm": "range"}}
    settings = {"height_mm": 25.4, "resolution": "fast"}
    runs = runs_of(Specification(program=[str(line), str(again)], seeds=1, settings=settings, sobol=sobol))
    found = {str(line): [], str(again): []}
    for run in runs:
        found[run.task] += [value for _, value in run.settings["constants"]]
    for file, machine in ((line, "agiecut-dem15"), (again, "production")):
        low, high = Machine.load(machine).uncertain()["guides.clearance_mm"].range
        assert low <= min(found[str(file)]) < high / 2 < max(found[str(file)]) <= high


def test_seeds_of_environments_are_those_held_back():
    spec = Specification(environment="edmsim/GapFeed-v2", seeds=3)
    assert [run.seed for run in runs_of(spec)] == [HELD_BACK, HELD_BACK + 1, HELD_BACK + 2]


@pytest.mark.parametrize(("options", "named"), [
    ({}, "either program or environment"),
    ({"program": "none.ngc"}, "none.ngc"),
    ({"colour": "red"}, "under [settings]"), ({"setings": {}}, "did you mean 'settings'?"),
    ({"grid": {"colour": 5}}, "a cut has no option 'colour'; there are those of edmsim cut --help, and constants"),
    ({"grid": {"heigt": 5}}, "did you mean 'height'?"),
    ({"settings": {"height": [5, 10]}}, "height is one value under [settings], not [5, 10]: several to try go under"),
    ({"settings": {"gap.critical_um": [4, 5]}}, "[grid]"),
    ({"grid": {"wire_spede": 5}}, "did you mean 'wire-speed'?"),
    ({"grid": {"seed": [1, 2]}}, "give seeds"),
    ({"grid": {"height_mm": []}}, "no value"),
    ({"grid": {"t_on": "10:40:-5"}}, "FIRST:LAST:STEP"), ({"grid": {"t_on": "0:100000:1"}}, "FIRST:LAST:STEP"),
    ({"grid": {"height_mm": 5}, "settings": {"height": 5}}, "given twice"),
    ({"settings": {"height_mm": 900}}, "900"),
    ({"settings": {"controller": "genius"}}, "genius"),
    ({"settings": {"gap.colour": 5}}, "gap.critical_um"),
    ({"settings": {"wire.stress_MPa": 5}}, "tension"),
    ({"settings": {"gap.critical_um": "wide"}}, "wide"),
    ({"seeds": [0, -1]}, "seeds.1 cannot be -1"), ({"seeds": [1, 2, 1]}, "seeds has 1 twice"),
    ({"grid": {"height_mm": "5,5:20:5"}}, "height_mm has 5 twice"), ({"grid": {"height_mm": [5, 5.0]}}, "5.0 twice"),
    ({"sobol": {"samples": 6, "ranges": {"tension": [8, 12]}}}, "4 or 8"),
    ({"sobol": {"samples": 4, "ranges": {"tension": [12, 8]}}}, "[low, high]"),
    ({"sobol": {"samples": 4, "ranges": {"tension": "range"}}}, "published range"),
    ({"sobol": {"samples": 4}}, "sobol.ranges is missing"),
    ({"recordings": "video"}, "video"), ({"sample_only": ["gap"]}, "give their number as machine_samples"),
])  # fmt: skip
def test_what_is_no_sweep_is_refused_in_one_line(line, options, named):
    start = {} if options in ({}, {"program": "none.ngc"}) else {"program": str(line)}
    with pytest.raises(InputError) as refused:
        next(runs_of(Specification.model_validate({**start, **options})))
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("options", "named"), [
    ({"machine_samples": 2}, "randomise"), ({"recordings": "all"}, "no recordings"),
    ({"environment": ["edmsim/GapFeed-v2"] * 2}, "environment has 'edmsim/GapFeed-v2' twice"),
    ({"settings": {"colour": 1}}, "colour"), ({"settings": {"controller": ["counts"]}}, r"under \[grid\]"),
    ({"settings": {"gap.critical_um": 5}}, "randomise"),
    ({"grid": {"weights.colour": [1]}}, "weights has no entry 'colour'"),
    ({"grid": {"machine.wire": ["brass-200"]}, "settings": {"machine": "production"}}, "give one of them"),
])  # fmt: skip
def test_what_an_environment_cannot_do_is_refused(options, named):
    with pytest.raises(InputError, match=named):
        next(runs_of(Specification.model_validate({"environment": "edmsim/GapFeed-v2", **options})))


def test_a_file_that_is_none_says_where(tmp_path):
    file = tmp_path / "sweep.toml"
    for text in ("seeds = [", "seeds = 0.5", "\udcff"):
        file.write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(InputError, match=r"sweep.toml: "):
            read_specification(file)


def test_a_list_has_each_controller_once():
    assert listed("counts, fixed:feed_um_s=2,patience_s=1,counts,") == ["counts", "fixed:feed_um_s=2,patience_s=1"]
