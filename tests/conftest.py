"""A small part for the tests that need a whole cut: a punch of 1 x 1 mm, some two minutes of machine time."""

import base64
import gc
import signal
import sys
from functools import partialmethod
from importlib import resources
from importlib.util import module_from_spec, spec_from_file_location
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from hypothesis import settings

import edmsim
from edmsim.cli import app as cli
from edmsim.envs.episode import Task
from edmsim.learning import hyperparameters

from .worker_stacks import pytest_configure  # noqa: F401, a hook


def pytest_collection():
    """Stop garbage collection while modules are imported and tests are collected, because these objects are kept."""
    gc.disable()


@pytest.hookimpl(tryfirst=True)  # before slow tests are deselected
def pytest_collection_modifyitems(items):
    """Mark tests that need the whole cut as slow."""
    for item in items:
        if "small_cut" in getattr(item, "fixturenames", ()):
            item.add_marker("slow")


def pytest_collection_finish():
    """Let the garbage collector skip modules and tests, and seldom scan old objects: it took a tenth of the time."""
    gc.freeze()
    gc.set_threshold(700, 10, 100)
    gc.enable()


# no deadline, because a busy machine is slow; each run draws other examples
settings.register_profile("untimed", deadline=None, max_examples=50)
settings.load_profile("untimed")

PUNCH = """\
G21 G90
G0 X-2.5 Y0.5
G41 D1
G1 X0 Y0.5
Y1
X1
Y0
X0
Y0.5
G40
M2
"""


@pytest.fixture(scope="session")
def load_script():
    """Load a Python file outside packages as a script."""

    def load(file):
        spec = spec_from_file_location(f"script_{file.stem}", file)
        module = module_from_spec(spec)
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(file.parent)  # a script can import files next to it
            spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session", autouse=True)
def folders_of_learners(tmp_path_factory):
    """Let stable-baselines3 write the logs of a learner without logger to the folder of temporary files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SB3_LOGDIR", str(tmp_path_factory.getbasetemp() / "sb3"))
        yield


class Outcome(NamedTuple):
    """The result of a command: exit status, standard output and standard error."""

    status: int
    out: str
    err: str


FILES = ["cut.rrd", "part.npz", "profile.png", "report.html", "report.json", "windows.parquet"]
"""What a cut writes."""


def timeless(report):
    """Return a report without figures of the computer's clock."""
    return {name: value for name, value in report.items() if name not in ("wall_time_s", "realtime_factor")}


@pytest.fixture(name="edmsim")
def command_line(monkeypatch, capsys):
    """Run a command in this process, as ``edmsim("cut", file, "--out", folder)``."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["edmsim", *map(str, words)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        code = left.value.code
        return Outcome(code if isinstance(code, int) else 0, *capsys.readouterr())

    return run


@pytest.fixture
def signals():
    """Set Python's default signal handlers, which the test runner, nohup or a background job may have changed."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


DOT = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR42mNgAAAAAgAB5Sfe/AAAAABJRU5ErkJggg==")
"""A picture of one point."""


@pytest.fixture
def draws_pictures():
    """Let cuts of a test draw their pictures, see `pictures_of_cuts`."""


@pytest.fixture(autouse=True)
def pictures_of_cuts(request, monkeypatch):
    """Let cuts write a point as their picture, and a page without figures, which take most of a short cut's time.

    `small_cut`, all of `tests/recording` and the tests with `draws_pictures` draw them.
    """
    if "draws_pictures" not in request.fixturenames:
        monkeypatch.setattr("edmsim.recording.html_report.profile_png", lambda *_: DOT)
        monkeypatch.setattr("edmsim.recording.html_report.pictures", lambda *_: iter(()))
        monkeypatch.setattr("edmsim.job.result.sample_or_reason", lambda *_: "not simulated")


@pytest.fixture
def own_file(tmp_path):
    """Write a file of `models/` with some of its text changed, and return its path."""

    def write(kind, name, *changes):
        text = (resources.files("edmsim.models") / kind / f"{name}.toml").read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        file = tmp_path / "own.toml"
        file.write_text(text, encoding="utf-8")
        return str(file)

    return write


@pytest.fixture
def hot_machine(own_file):
    """Write the file of a machine whose wire gets much heat and little cooling, and breaks."""
    return own_file(
        "machines", "agiecut-dem15",
        ("convection_W_m2K = { value = 14000.0, range = [5000.0, 30000.0],", "convection_W_m2K = { value = 300.0,"),
        ("critical_W_m2 = { value = 4.0e6, range = [1.0e6, 1.0e7],", "critical_W_m2 = { value = 1.0e3,"),
        ("critical_stream = { value = 7.19e4, range = [5.0e4, 9.0e4],", "critical_stream = { value = 0.0,"),
        ("wire_heat_share = { value = 0.1, range = [0.05, 0.2],", "wire_heat_share = { value = 0.3,"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def short_episodes():
    """Limit episodes to four seconds in comparisons of controllers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Task, "__init__", partialmethod(Task.__init__, episode_s=4.0))
        yield


@pytest.fixture(scope="session")
def small_punch(tmp_path_factory):
    """Part program of the punch."""
    file = tmp_path_factory.mktemp("program") / "small.ngc"
    file.write_text(PUNCH)
    return file


@pytest.fixture(scope="session")
def cut_small(small_punch):
    """Cut the punch from thin stock at coarse resolution; takes options of `edmsim.cut`."""

    def cut(**options):
        return edmsim.cut(small_punch, **{"height_mm": 5.0, "resolution": "fast", "seed": 1, **options})

    return cut


@pytest.fixture(scope="session")
def small_cut(cut_small, tmp_path_factory):
    """Return the finished cut of the punch, its folder, and the `Progress` after each window."""
    folder = tmp_path_factory.mktemp("out") / "new" / "punch"
    progress = []
    return SimpleNamespace(result=cut_small(out=folder, watch=progress.append), folder=folder, progress=progress)


@pytest.fixture
def short_training(monkeypatch):
    """Shorten trainings: few sub-environments, few windows between updates."""
    load = hyperparameters.load

    def shorter(env_id, algo, settings=None):
        usual = load(env_id, algo, settings)
        replays = {"learning_starts": 40, "buffer_size": 500}
        change = {"n_steps": 32, "batch_size": 32} if algo not in ("sac", "tqc") else replays
        small = usual.network.model_copy(update={"widths": [16]})
        return usual.model_copy(update={"num_envs": 2, "algorithm": {**usual.algorithm, **change}, "network": small})

    monkeypatch.setattr(hyperparameters, "load", shorter)
