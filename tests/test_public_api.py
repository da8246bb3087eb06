"""What users import: the agreed names, and an import that stays cheap."""

import inspect
import math
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml

import edmsim
from edmsim.axis_bench.bench import AxisBench
from edmsim.axis_bench.control_rig import ControlRig
from edmsim.controllers import axis
from edmsim.evaluation.compare import evaluate, leaderboard
from edmsim.hil.boards import Rig
from edmsim.measure import measure_guides, measure_table
from edmsim.program.passes import PassPlan
from edmsim.program.path import load_program, plan_path
from edmsim.program.tables import read_offsets

HEAVY = ("rerun", "matplotlib", "torch", "numba", "mujoco", "scipy", "pyarrow", "ezdxf", "shapely", "pydantic")


@pytest.fixture(scope="module")
def plant():
    return edmsim.Plant(edmsim.Machine.load(), resolution="fast")


@pytest.mark.slow
def test_nothing_heavy_is_imported_before_it_is_needed():
    steps = ("import edmsim", "edmsim.Machine.load(); edmsim.controllers.make('counts')", "edmsim.cut")
    code = "import sys\n" + "".join(f"{step}\nprint(*sys.modules)\n" for step in steps)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported, made, cut = (set(line.split()) for line in done.stdout.splitlines())
    assert imported.isdisjoint({*HEAVY, "edmsim.envs.environment"})  # although environments are registered
    assert made.isdisjoint({"rerun", "matplotlib", "torch", "mujoco", "scipy.signal", "pyarrow"})
    assert cut.isdisjoint({"rerun", "matplotlib", "torch", "scipy.signal"})


@pytest.mark.parametrize("name", edmsim.__all__)
def test_public_name_resolves_and_is_documented(name):
    assert inspect.getdoc(getattr(edmsim, name))


def test_a_list_of_names_holds_the_public_ones_and_nothing_else():
    assert {name for name in dir(edmsim) if not name.startswith("__")} == set(edmsim.__all__)


@pytest.mark.parametrize(("call", "said"), [
    (lambda: edmsim.cut(None), r"program cannot be None: give str \| Path"),
    (lambda: edmsim.cut(object()), r"program cannot be <object object at \w+>: give str \| Path"),
    (lambda: edmsim.controllers.make(["counts"]), r"name cannot be \['counts'\]: give str"),
    (lambda: edmsim.controllers.found_gains("voltge"), "no feed controller 'voltge'.* did you mean 'voltage'"),
    (lambda: edmsim.controllers.check_controller(edmsim.controllers.make("fixed")), "make is FixedController.*class"),
    (lambda: axis.check_drive(axis.make("uhu")), r"make is <.*Uhu object at \w+>: give what returns a new drive"),
    (lambda: axis.make(["uhu"]), r"name cannot be \['uhu'\]: give str"),
    (lambda: ControlRig("xy"), r"axes cannot be 'xy': give Mapping\[str, ControlAxis\]"),
    (lambda: PassPlan("0.2"), r"offsets_mm cannot be '0.2': give tuple\[float, \.\.\.\]"),
    (lambda: leaderboard("."), r"^\.: this is a folder"),
    (lambda: edmsim.Machine("worn-table"), r"read from its files: edmsim.Machine.load\('worn-table'\)$"),
    (lambda: edmsim.Machine.load().sample(1), "rng cannot be 1: give np.random.Generator"),
    (lambda: edmsim.Machine.load().sample(None, only=5), "rng cannot be None"),
    (lambda: edmsim.Machine.load().sample(np.random.default_rng(), "gap"), "only is the text 'gap': give a list, as"),
    (lambda: load_program("part.ngc", ignore="QT"), r"ignore is the text 'QT': give a list, as \['QT'\]$"),
    (lambda: edmsim.Plant(edmsim.Machine.load(), drives=5), r"drives cannot be 5: give Mapping\[str, AxisDrive\]"),
    (lambda: edmsim.Plant(edmsim.Machine.load(), seed=None), "seed is None"),
    (lambda: edmsim.Plant(edmsim.Machine.load(), seed=-1), "seed is -1: give a whole number, 0 or more"),
    (lambda: edmsim.Machine.load().with_(pulse_shape=[]), r"unknown pulse shape \[\]"),
    (lambda: edmsim.Machine.load().with_(heigth_mm=5), "'heigth_mm' to change; there are: tension, .* 'height_mm'"),
    (lambda: Rig(5), r"board cannot be 5: give str \| Board"),
    (lambda: axis.from_text("uhu").line("R"), "text cannot be 'R': give bytes"),
    (lambda: measure_table(edmsim.Machine.load(), seed=-1), "seed is -1: give a whole number, 0 or more"),
    (lambda: measure_guides(5), "machine cannot be 5: give Machine"),
    (lambda: edmsim.Plant(np.zeros(3)), r"machine cannot be array\(.*\): give Machine"),
    (lambda: edmsim.Plant(edmsim.Machine.load(), stock=np.zeros(3)), r"stock cannot be array\(.*\): give Stock"),
    (lambda: edmsim.envs.EdmEnv("GapFeed", render_mode=np.zeros(3)), "unknown render_mode"),
    (lambda: edmsim.envs.register(None, edmsim.envs.GapFeed), "env_id cannot be None: give str"),
    (lambda: evaluate("edmsim/GapFeed-v2", 5), r"controllers cannot be 5: give Sequence\[str\]"),
    (lambda: read_offsets(None), r"file cannot be None: give str \| Path"),
    (lambda: plan_path("x.ngc", auto_offset_mm=0.1, corners="round"), "unknown corners 'round'; there are: sharp"),
    (lambda: edmsim.envs.make_sb3_vec_env("edmsim/GapFeed-v2", feed=3), "GapFeed has no argument 'feed'; it has"),
    (lambda: plan_path(b"x", auto_offset_mm=0.1), r"file cannot be b'x': give str \| Path \| Program"),
])  # fmt: skip
def test_an_argument_of_another_type_is_named(call, said):
    with pytest.raises(edmsim.InputError, match=said):
        call()


@pytest.mark.parametrize(("call", "said"), [
    (lambda plant: plant.drift(5), "machine cannot be 5: give Machine"),
    (lambda plant: plant.walls_um(99), "slice_index is 99: give a whole number from 0 to 4"),
    (lambda plant: plant.walls_um(-1), "slice_index is -1"),
    (lambda plant: plant.switch_generator(""), "on is '': give True or False"),
    (lambda plant: plant.set_generator([], 100.0), r"t_on_us cannot be \[\]: give float"),
    (lambda plant: plant.set_generator(10**400, 100.0), "t_on_us is 1000.*: give a finite number"),
    (lambda plant: plant.advance((), np.float64(3)), r"pulses is np.float64\(3.0\): give a whole number"),
    (lambda plant: plant.advance((), True), "pulses is True: give a whole number"),
    (lambda plant: plant.drift(edmsim.Machine.load(height_mm=30)), "another height_mm cannot go on"),
    (lambda plant: plant.with_machine(edmsim.Machine.load(height_mm=30)), "another height_mm cannot go on"),
    (lambda plant: plant.reset(-1, machine=edmsim.Machine.load(height_mm=30)), "seed is -1"),
    (lambda plant: plant.reset(1, stock=3, machine=edmsim.Machine.load(height_mm=30)), "stock cannot be 3"),
    (lambda plant: plant.drift(edmsim.Machine.load("worn-table")), "another base cannot go on"),
    (lambda plant: plant.restore({**plant.snapshot(), "state": [1]}), "its state is missing or of another kind"),
])  # fmt: skip
def test_a_plant_that_refused_an_argument_goes_on_as_before(plant, call, said):
    before = plant.snapshot()
    with pytest.raises(edmsim.InputError, match=said):
        call(plant)
    plant.restore(before)
    np.testing.assert_equal(plant.snapshot(), before)
    assert plant.machine.t_on_us == edmsim.Machine.load().t_on_us


@pytest.mark.parametrize("text", [5, None, [], b"VEL 5 0"])
def test_a_serial_line_takes_texts(text):
    rig = Rig("spark")
    for line in (rig.send, rig.move, rig.board.line):
        with pytest.raises(edmsim.InputError, match=r"text cannot be .*: give str"):
            line(text)
    with pytest.raises(edmsim.InputError, match="seconds is nan"):
        rig.run(math.nan)
    bench = AxisBench({"x": axis.from_text("uhu")})
    for call in (bench.hold, bench.reset_pin):
        with pytest.raises(edmsim.InputError, match="give True or False"):
            call("x", text)
    for send in (bench.send, bench.talk):
        with pytest.raises(edmsim.InputError, match=r"data cannot be .*: give bytes"):
            send("a" if text in (None, b"VEL 5 0") else text)


def test_errors_that_no_argument_explains_stay_as_they_are():
    with pytest.raises(AttributeError, match="'random'"):
        edmsim.Machine.load().sample(Path())


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'edmsim' has no attribute 'Lathe'"):
        edmsim.Lathe  # noqa: B018
    assert not hasattr(edmsim, "Lathe")


def test_errors_have_one_base():
    assert issubclass(edmsim.InputError, edmsim.EdmsimError)
    error = edmsim.InputError("it is wrong", "a.ngc", 3)
    assert str(error) == "a.ngc:3: it is wrong"
    assert (error.reason, error.file, error.line) == ("it is wrong", "a.ngc", 3)


def test_the_citation_names_this_version_and_licence():
    root = Path(__file__).parents[1]
    cited = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    assert (cited["version"], cited["license"]) == (edmsim.__version__, project["license"])
