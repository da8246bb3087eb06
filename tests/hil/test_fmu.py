"""``edmsim gap --fmu``: run in FMPy, to the bit like the same cut in Python; states taken and set; refusals."""

import math
import shutil
import zipfile
from contextlib import contextmanager
from pathlib import Path

import pytest

import edmsim
from edmsim.errors import InputError
from edmsim.hil.fmu import export_fmu
from edmsim.hil.gap import Gap, Output

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu3")
STEP_S = 0.0255
FEEDS = (4.0, 6.0, -10.0, 3.0, 8.0, 8.0, 0.0, 5.0)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    file = tmp_path_factory.mktemp("fmu") / "gap.fmu"
    assert export_fmu(file, material="tool-steel") == pytest.approx(STEP_S)
    return file


class Instance:
    """An FMU under way, its variables by name."""

    def __init__(self, fmu, description):
        self.fmu = fmu
        self._variables = {variable.name: variable for variable in description.modelVariables}
        self.time = 0.0

    def set(self, name, value):
        variable = self._variables[name]
        getattr(self.fmu, f"set{variable.type}")([variable.valueReference], [value])

    def get(self, name):
        variable = self._variables[name]
        return getattr(self.fmu, f"get{variable.type}")([variable.valueReference])[0]

    def step(self, feed_um_s):
        self.set("feed_x_um_s", feed_um_s)
        self.fmu.doStep(self.time, STEP_S)
        self.time += STEP_S
        names = ("short_share", "open_share", "mean_voltage_V", "mean_current_A", "lag_x_um", "x_um")
        return tuple(self.get(name) for name in names)


@contextmanager
def instance(file, initialise=True, **parameters):
    description = fmpy.read_model_description(str(file), validate=True)
    folder = fmpy.extract(str(file))
    try:
        fmu = fmpy.instantiate_fmu(folder, description, "CoSimulation")
        own = Instance(fmu, description)
        for name, value in parameters.items():
            own.set(name, value)
        if initialise:
            fmu.enterInitializationMode()
            fmu.exitInitializationMode()
        yield own
        fmu.terminate()
        fmu.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.slow
def test_it_cuts_as_the_gap_in_python_to_the_bit(file):
    gap = Gap(edmsim.Machine.load(height_mm=10.0, tension=8.0), 7)
    with instance(file, height_mm=10.0, tension_N=8.0, seed=7) as fmu:
        for feed in FEEDS:
            gap.setpoints.move_at((feed, 0.0), gap.plant.time_ns)
            window = gap.run(Output(255, True, 30.0, 100.0)).window
            assert fmu.step(feed) == (
                window.short / 255, window.open / 255, window.mean_voltage_V, window.mean_current_A,
                window.deflection_um[0], gap.place_um[0],
            )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("as_bytes", [False, True])
def test_a_state_taken_goes_on_to_the_bit(file, as_bytes):
    with instance(file, seed=3) as fmu:
        for feed in FEEDS[:3]:
            fmu.step(feed)
        state, at = fmu.fmu.getFMUState(), fmu.time
        if as_bytes:
            packed = fmu.fmu.serializeFMUState(state)
            fmu.fmu.freeFMUState(state)
        goes_on = [fmu.step(feed) for feed in FEEDS]
        if as_bytes:
            state = fmu.fmu.deserializeFMUState(packed)
        fmu.fmu.setFMUState(state)
        fmu.time = at
        assert [fmu.step(feed) for feed in FEEDS] == goes_on


@pytest.mark.slow
def test_a_simulation_may_start_at_any_time_and_go_on_in_an_instance_that_was_not_initialised(file):
    rows = []
    for start_s in (0.0, 2.0):
        with instance(file, seed=3) as fmu:
            fmu.time = start_s
            rows.append([fmu.step(feed) for feed in FEEDS[:4]])
            packed = fmu.fmu.serializeFMUState(fmu.fmu.getFMUState())
            at, goes_on = fmu.time, [fmu.step(feed) for feed in FEEDS]
    assert rows[0] == rows[1]
    with instance(file, initialise=False, seed=3) as fmu:
        fmu.fmu.setFMUState(fmu.fmu.deserializeFMUState(packed))
        fmu.time = at
        assert [fmu.step(feed) for feed in FEEDS] == goes_on


@pytest.mark.slow
def test_settings_count_from_the_next_step_on_and_time_is_never_lost(file):
    with instance(file) as fmu:
        fmu.set("t_period_us", 120.0)
        fmu.set("t_on_us", 20.0)
        shares = [fmu.step(3.0)[0] for _ in range(4)]
        pulses = 212.0  # of 212.5, the half left over
        assert all(abs(share * pulses - round(share * pulses)) < 1e-6 for share in shares[:1])
        fmu.set("generator_on", False)
        assert fmu.step(0.0)[2:4] == (pytest.approx(0.0, abs=0.01), 0.0)


@pytest.mark.slow
def test_it_runs_without_the_files_that_it_was_written_from(tmp_path):
    models = Path(edmsim.models.__file__).parent
    for name, written in (("machines/agiecut-dem15.toml", "own.toml"), ("materials/copper.toml", "metal.toml")):
        text = (models / name).read_text()
        (tmp_path / written).write_text(text.replace('model = "agiecut_dem15.xml"', 'model = "own.xml"'))
    shutil.copy(models / "agiecut_dem15.xml", tmp_path / "own.xml")
    machine = {"name": str(tmp_path / "own.toml"), "material": str(tmp_path / "metal.toml"), "tension": 8.0}
    export_fmu(tmp_path / "gap.fmu", seed=7, **machine)
    gap = Gap(edmsim.Machine.load(**machine), 7)
    for own in (*tmp_path.glob("*.toml"), tmp_path / "own.xml"):
        own.unlink()
    with instance(tmp_path / "gap.fmu") as fmu:
        assert (fmu.get("tension_N"), fmu.get("seed")) == (8.0, 7)
        window = gap.run(Output(255, True, 30.0, 100.0)).window
        assert fmu.step(0.0)[2:4] == (window.mean_voltage_V, window.mean_current_A)


@pytest.mark.slow
def test_a_step_of_another_length_and_a_setting_that_cannot_be_are_errors(file, capsys):
    with instance(file) as fmu, pytest.raises(fmpy.fmi1.FMICallException):
        fmu.fmu.doStep(0.0, 0.01)
    with instance(file) as fmu:
        fmu.set("t_on_us", 500.0)
        with pytest.raises(fmpy.fmi1.FMICallException):
            fmu.step(1.0)
    with instance(file) as fmu, pytest.raises(fmpy.fmi1.FMICallException):
        fmu.step(math.nan)
    with instance(file) as fmu:
        fmu.set("t_period_us", math.nan)
        with pytest.raises(fmpy.fmi1.FMICallException, match=r"\(error\)"):
            fmu.step(1.0)
    with instance(file, height_mm=-1.0) as fmu:
        assert "workpiece height -1 mm is not within" in capsys.readouterr().out
        with pytest.raises(fmpy.fmi1.FMICallException, match=r"\(error\)"):
            fmu.step(1.0)


def test_the_description_says_what_it_needs_and_can(file):
    description = fmpy.read_model_description(str(file), validate=True)
    assert description.fmiVersion == "3.0"
    with zipfile.ZipFile(file) as packed:
        written = packed.read("modelDescription.xml").decode()
    for able, what in (
        ("true", "needsExecutionTool"), ("true", "canGetAndSetFMUState"), ("true", "canSerializeFMUState"),
        ("false", "canHandleVariableCommunicationStepSize"),
    ):  # fmt: skip
        assert f'{what}="{able}"' in written
    assert description.defaultExperiment.stepSize == str(STEP_S)


def test_refusals(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"written as \.fmu"):
        export_fmu(tmp_path / "gap.zip")
    with pytest.raises(InputError, match=r"no machine|unknown|lathe"):
        export_fmu(tmp_path / "gap.fmu", name="lathe")
    with pytest.raises(InputError, match="the gap is 1 to 250 um, a wire's diameter, not -1"):
        export_fmu(tmp_path / "gap.fmu", gap_um=-1)
    monkeypatch.setitem(__import__("sys").modules, "pythonfmu3", None)
    with pytest.raises(InputError, match=r"pip install 'edmsim\[fmu\]'"):
        export_fmu(tmp_path / "gap.fmu")
    assert not list(tmp_path.iterdir())
