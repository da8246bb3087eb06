"""The code that runs inside the FMU of ``edmsim gap --fmu``: a gap whose inputs a co-simulation sets.

The file itself is packed into the FMU; it needs edmsim where it runs.
"""

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pythonfmu3 as fmu
from pydantic import ValidationError

from edmsim import __version__
from edmsim.errors import EdmsimError, InputError
from edmsim.files import read_arrays
from edmsim.hil.gap import Gap, Output
from edmsim.machine import pulse_window, setting
from edmsim.machine.machine import Machine
from edmsim.numeric import finite

SETTINGS = "edmsim.json"
"""File next to this one with ``machine``, all its constants, and the other settings of `export_fmu`."""
INPUTS = {
    "feed_x_um_s": "speed of x", "feed_y_um_s": "speed of y", "t_on_us": "on-time, from the next step on",
    "t_period_us": "period, from the next step on",
}  # fmt: skip
PARAMETERS = {"height_mm": "workpiece height", "tension_N": "wire tension"}
OUTPUTS = {
    "short_share": "share of pulses that were shorts", "open_share": "share of open pulses",
    "spark_share": "share of pulses that ignited", "mean_voltage_V": "mean gap voltage",
    "mean_current_A": "mean gap current", "lag_x_um": "mean deflection of the wire in x",
    "lag_y_um": "mean deflection of the wire in y", "x_um": "position counter of x, from the start",
    "y_um": "position counter of y, from the start",
}  # fmt: skip


class EdmsimGap(fmu.Fmi3Slave):  # type: ignore[misc]
    """The slave: a fixed step of one window, get and set of its state by snapshots."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._settings = json.loads((Path(self.resources) / SETTINGS).read_text(encoding="utf-8"))
        self._machine = self._packed_machine()
        self.author, self.description = "edmsim", "A wire-EDM gap, simulated discharge by discharge"
        self.version = __version__
        step_s = self._settings["step_s"]
        self.default_experiment = fmu.DefaultExperiment(start_time=0.0, stop_time=400 * step_s, step_size=step_s)
        self.time = 0.0
        self.feed_x_um_s = self.feed_y_um_s = 0.0
        self.t_on_us, self.t_period_us = self._machine.t_on_us, self._machine.t_period_us
        self.height_mm, self.tension_N = self._machine.height_mm, self._machine.tension
        self.seed = self._settings["seed"]
        self.generator_on, self.wire_broken = True, False
        for name in OUTPUTS:
            setattr(self, name, 0.0)
        self._gap: Gap | None = None
        self._start_s = math.nan  # begin of the first step, at which the gap's clock is 0; NaN before it
        self._register()

    def _packed_machine(self) -> Machine:
        """Return the set-up in the FMU, with the FMU's MJCF if it has one."""
        constants = self._settings["machine"]
        mjcf = Path(self.resources) / Path(constants["base"]["model"]).name
        if mjcf.is_file():
            constants["base"]["model"] = str(mjcf)
        try:
            return Machine.model_validate(constants)
        except ValidationError:
            raise InputError("another version of edmsim wrote this FMU: write it again by edmsim gap --fmu") from None

    def _register(self) -> None:
        fixed, discrete = fmu.Fmi3Variability.fixed, fmu.Fmi3Variability.discrete
        as_input = {"causality": fmu.Fmi3Causality.input, "variability": discrete}
        as_output = {"causality": fmu.Fmi3Causality.output, "variability": discrete}
        as_parameter = {"causality": fmu.Fmi3Causality.parameter, "variability": fixed}
        time = {"causality": fmu.Fmi3Causality.independent, "variability": fmu.Fmi3Variability.continuous}
        variables = [
            fmu.Float64("time", **time),
            *(fmu.Float64(name, description=text, **as_input) for name, text in INPUTS.items()),
            fmu.Boolean("generator_on", description="whether pulses are fired", **as_input),
            *(fmu.Float64(name, description=text, **as_parameter) for name, text in PARAMETERS.items()),
            fmu.Int64("seed", description="seed of every draw", **as_parameter),
            *(fmu.Float64(name, description=text, **as_output) for name, text in OUTPUTS.items()),
            fmu.Boolean("wire_broken", description="whether there is no wire", **as_output),
        ]
        for variable in variables:
            self.register_variable(variable)

    def exit_initialization_mode(self) -> None:
        """Make the gap from the parameters; if they are invalid, log the reason, and every step fails."""
        try:
            self._gap = self._new_gap()
        except EdmsimError as error:
            self.log(str(error), fmu.Fmi3Status.error)

    def _new_gap(self) -> Gap:
        machine = self._machine.with_(height_mm=self.height_mm, tension=self.tension_N)
        chosen = {"resolution": self._settings["resolution"], "gap_um": self._settings["gap_um"]}
        return Gap(machine, self.seed, **chosen)

    def do_step(self, current_time: float, step_size: float) -> fmu.Fmi3StepResult:
        """Run the pulses that begin and end within the step; its length is fixed."""
        step_s = self._settings["step_s"]
        try:
            if self._gap is None:
                raise EdmsimError("no step: not initialized yet, or its parameters were refused")
            if abs(step_size - step_s) > 1e-6 * step_s:
                raise EdmsimError(f"steps are {step_s:.9g} s, one window of pulses, not {step_size:.9g}")
            if math.isnan(self._start_s):
                self._start_s = current_time
            self._run(self._gap, round((current_time + step_size - self._start_s) * 1e9))
        except EdmsimError as error:
            self.log(str(error), fmu.Fmi3Status.error)
            return fmu.Fmi3StepResult(fmu.Fmi3Status.error)
        return fmu.Fmi3StepResult(fmu.Fmi3Status.ok)

    def _run(self, gap: Gap, until_ns: int) -> None:
        t_on_us, t_period_us = (finite(name, getattr(self, name)) for name in ("t_on_us", "t_period_us"))
        output = Output(setting.WINDOW_PULSES, bool(self.generator_on), t_on_us, t_period_us)
        windows: list[pulse_window.PulseWindow] = []
        while (room := self._room(gap, output, until_ns)) > 0:
            gap.setpoints.move_at((self.feed_x_um_s, self.feed_y_um_s), gap.plant.time_ns)
            windows.append(gap.run(output._replace(pulses=min(room, setting.WINDOW_PULSES))).window)
        if windows:
            for name, value in zip(OUTPUTS, _means(windows), strict=False):
                setattr(self, name, value)
        self.x_um, self.y_um = gap.place_um
        self.wire_broken = bool(gap.lost)

    def _room(self, gap: Gap, output: Output, until_ns: int) -> int:
        """Return the number of pulses that certainly end by then; the next step begins with the rest of the time."""
        timing = gap.plant.timing
        varies = timing.period_ns == 0
        longest_us = timing.wait_us + output.t_period_us if varies else output.t_period_us
        return math.floor((until_ns - gap.plant.time_ns) * 1e-3 / longest_us + 1e-6)

    def _names(self) -> list[str]:
        return [*INPUTS, *OUTPUTS, "generator_on", "wire_broken", "_start_s"]

    def _get_fmu_state(self) -> dict[str, Any]:
        values = np.array([float(getattr(self, name)) for name in self._names()])
        gap = {} if self._gap is None else self._gap.snapshot()
        return {**gap, "fmu.values": values}

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        for name, value in zip(self._names(), state["fmu.values"].tolist(), strict=True):
            setattr(self, name, bool(value) if name in ("generator_on", "wire_broken") else value)
        rest = {name: value for name, value in state.items() if name != "fmu.values"}
        if not rest:
            self._gap = None
        else:
            self._gap = self._gap or self._new_gap()
            self._gap.restore(rest)

    @staticmethod
    def _fmu_state_to_bytes(state: dict[str, Any]) -> bytes:
        packed = io.BytesIO()
        np.savez(packed, **state)
        return packed.getvalue()

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> dict[str, Any]:
        return read_arrays(state)


def _means(windows: list[pulse_window.PulseWindow]) -> tuple[float, ...]:
    """Return the outputs of a step's windows as if they were one window; a single one has its own values."""
    kinds = ("pulses", "short", "open", "spark", "arc")
    pulses, short, open_, spark, arc = (sum(getattr(window, kind) for window in windows) for kind in kinds)
    rows = [(w.mean_voltage_V, w.mean_current_A, *w.deflection_um) for w in windows]
    weights = [window.duration_ns for window in windows] if len(windows) > 1 else None
    means = np.average(rows, axis=0, weights=weights)
    return short / pulses, open_ / pulses, (spark + arc) / pulses, *map(float, means)
