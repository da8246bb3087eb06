"""``edmsim console positioner``: a QMOVE control with its positioners on a bench.

Inputs and outputs have their slot addresses as names, so one input can serve both the program and a device's
homing. The program runs a pass every millisecond (ours).
"""

import codecs
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, Self

from edmsim.axis_bench import AxisBench
from edmsim.consoles.scope import Scope
from edmsim.controllers.axis.drive import axis_names, axis_row
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.controllers.qcl import Control, read_configuration, read_program
from edmsim.errors import InputError, located, methods_refuse_wrong_types, one_of
from edmsim.files import read_text
from edmsim.numeric import finite
from edmsim.plant.axes.drives import AXIS_NAMES

_BYTE_ORDER_MARK = codecs.BOM_UTF8.decode("latin-1")  # some editors write it at the beginning of a file
PASS_NS = 1_000_000  # period of the program's passes (ours)


class Press(NamedTuple):
    """An input that is closed for a time: its name, begin and end in s."""

    name: str
    from_s: float
    to_s: float


class Contactors:
    """Interlocked contactors (outputs by axis) that connect a drive to the motor of one axis at a time (ours)."""

    def __init__(self, bench: AxisBench, coils: dict[str, str]) -> None:
        self._bench, self._coils = bench, coils
        self._closed: str | None = None
        bench.share_output(list(coils), None)

    def obey(self, outputs: Mapping[str, bool]) -> None:
        """Open and close the contactors by the outputs of their coils."""
        if self._closed is not None and outputs[self._coils[self._closed]]:
            return
        closed = next((axis for axis, coil in self._coils.items() if outputs[coil]), None)
        if closed != self._closed:
            self._closed = closed
            self._bench.share_output(list(self._coils), closed)


@methods_refuse_wrong_types
class Station:
    """A control, its program, and its devices, each on its own axis.

    Parameters
    ----------
    configuration, program : str
        Texts of QCL.
    axis : str
        Motor, screw and table of every device (`edmsim.controllers.axis.drive.axis_row`).
    files : pair of str, optional
        Names of both texts in errors.
    contactors : mapping of str to str
        Devices by the digital output of their contactor, which connects the drive at their analogue output to their
        motor (manual 1.4.1). By default the drive stays at the motor of the output's first device.

    Attributes
    ----------
    bench : AxisBench
    control : Control
    axes : dict of str to str
        The bench's axis of every device by its name, in lower case.

    Raises
    ------
    QclError
        A text cannot be read.
    InputError
        There are no devices or more than axes, or a contactor's output or device is unknown,
        or the axis has no amplifier.
    """

    def __init__(
        self, configuration: str, program: str, axis: str = "analogue",
        files: tuple[str | None, str | None] = (None, None), contactors: Mapping[str, str] = MappingProxyType({}),
    ) -> None:  # fmt: skip
        self.configuration, self._file = read_configuration(configuration, files[0]), files[1]
        declared = self.configuration.devices
        if not 1 <= len(declared) <= len(AXIS_NAMES):
            raise InputError(
                f"the section INTDEVICE declares {len(declared)} devices; it must be 1 to {len(AXIS_NAMES)}", files[0]
            )
        amplified = axis_names(amplifier=True)
        if axis not in amplified:
            raise InputError(f"there is no axis {axis!r} with an amplifier; choose one of {one_of(axis, amplified)}")
        self.axes = dict(zip(declared, AXIS_NAMES, strict=False))
        self.bench = AxisBench(
            {self.axes[name]: Eanpos(axis_row(axis), one.tcamp_ms, one.resources) for name, one in declared.items()}
        )
        coils = self._coils(contactors)
        self._contactors: list[Contactors] = []
        for output in sorted({one.output for one in declared.values() if one.output is not None}):
            users = [name for name, one in declared.items() if one.output == output]
            if wired := {self.axes[name]: coils[name] for name in users if name in coils}:
                if len(wired) < len(users):
                    without = next(name for name in users if name not in coils)
                    raise InputError(
                        f"{without} shares {output}, whose other motors have contactors; it must have one"
                    )
                self._contactors.append(Contactors(self.bench, wired))
            elif len(users) > 1:
                self.bench.share_output([self.axes[name] for name in users], self.axes[users[0]])
        devices = {name: self.device(name) for name in declared}
        self.control = Control(self.configuration, read_program(program, self.configuration, files[1]), devices)

    @classmethod
    def of_files(
        cls, configuration: Path, program: Path, axis: str, contactors: Mapping[str, str] = MappingProxyType({})
    ) -> Self:
        """Load a station from two files."""
        texts = [read_text(file, "latin-1").removeprefix(_BYTE_ORDER_MARK) for file in (configuration, program)]
        return cls(texts[0], texts[1], axis, (str(configuration), str(program)), contactors)

    def _coils(self, contactors: Mapping[str, str]) -> dict[str, str]:
        """Return the addresses of the contactors' outputs by device."""
        coils: dict[str, str] = {}
        outputs = self.configuration.outputs
        for output, device in contactors.items():
            if output.lower() not in outputs:
                raise InputError(f"there is no output {output!r} for a contactor; there are: {', '.join(outputs)}")
            if device.lower() not in self.axes:
                raise InputError(f"there is no device {device!r}; there are: {', '.join(self.axes)}")
            if self.configuration.devices[device.lower()].output is None:
                raise InputError(f"{device} has no analogue output, so no contactor can lead a drive to it")
            if device.lower() in coils or outputs[output.lower()] in coils.values():
                raise InputError(f"{output}={device} is a second contactor of that output or that device")
            coils[device.lower()] = outputs[output.lower()]
        return coils

    def device(self, name: str) -> Eanpos:
        """Return a device by its name.

        Raises
        ------
        InputError
            The configuration has no such device.
        """
        if name.lower() not in self.axes:
            raise InputError(f"there is no device {name!r}; there are: {one_of(name, self.axes)}")
        found = self.bench.drive(self.axes[name.lower()])
        assert isinstance(found, Eanpos)
        return found

    def input(self, name: str) -> str:
        """Return the address of an input; raises `InputError` if the configuration has none of this name."""
        inputs = self.configuration.inputs
        if name.lower() not in inputs:
            raise InputError(f"there is no input {name!r}; there are: {one_of(name, inputs)}")
        return inputs[name.lower()]

    def press(self, name: str, closed: bool = True) -> None:
        """Close or open an input, for the program and for the devices that use it for homing.

        Raises
        ------
        InputError
            The configuration has no input of this name.
        """
        address = self.input(name)
        self.control.inputs[address] = closed
        for device, declaration in self.configuration.devices.items():
            if declaration.home_input == address:
                self.bench.press_home(self.axes[device], closed)

    def run(self, seconds: float) -> None:
        """Run the program and the axes.

        Raises
        ------
        InputError
            The program divides by zero, or assigns a value out of range.
        """
        end_ns = round((self.bench.time_s + finite("seconds", seconds, 0.0)) * 1e9)
        while (now_ns := round(self.bench.time_s * 1e9)) < end_ns:
            self.control.now_ms = now_ns // PASS_NS
            with located(self._file):
                waits_for = self.control.run_pass()
            for contactors in self._contactors:
                contactors.obey(self.control.outputs)
            if waits_for is None:
                self.bench.run_to(min((now_ns // PASS_NS + 1) * PASS_NS, end_ns))
            else:
                self.bench.run_to(int(self.device(waits_for).record["due_ns"][0]) + 1)

    def shown(self) -> dict[str, int]:
        """Return outputs and the devices' states by name."""
        outputs = {name: int(self.control.outputs[at]) for name, at in self.configuration.outputs.items()}
        states = {
            f"{device}:{name}": int(value)
            for device in self.axes for name, value in self.device(device).states.items() if name not in _FAST
        }  # fmt: skip
        return {**outputs, **states}


    @property
    def curves(self) -> dict[str, str]:
        """Curves of all axes for a scope, with their titles."""
        return {f"{device}/{name}": f"{device}: {title}" for device in self.axes for name, title in _CURVES.items()}

    def draw(self, scope: Scope) -> None:
        """Draw the samples of all axes since the last call; the bench's `trace` records them."""
        for device, axis in self.axes.items():
            samples = self.bench.samples(axis)
            for name in _CURVES:
                scope.draw(f"{device}/{name}", samples["time_ns"] * 1e-9, samples[name])


_CURVES = {
    "command": "output, share of 10 V", "current_A": "current, A", "place_um": "position, um",
    "speed_rad_s": "speed of the motor, rad/s",
}  # fmt: skip
_REPORTED = ("posit", "setpos", "vel", "follerr", "errcode", "wrncode")  # parameters printed at the end
_FAST = ("st_acc", "st_dec", "st_vconst", "st_int")  # states that every move changes several times


def run_and_report(
    station: Station, seconds: float, presses: list[Press], say: Callable[[str], None], scope: Scope | None = None
) -> None:
    """Run a station, press its inputs at their times, pass every change to `say`, and draw its axes."""
    station.bench.trace = scope is not None
    times = [(station.input(one.name), one.from_s, one.to_s) for one in presses]
    for one in presses:
        if one.from_s >= seconds:
            raise InputError(f"--press closes {one.name} at {one.from_s:g} s, but the run ends at {seconds:g} s")
    events = sorted({(at_s, one.name) for one in presses for at_s in one[1:]})
    before = station.shown()
    while station.bench.time_s < seconds - 1e-9:
        while events and events[0][0] <= station.bench.time_s + 1e-9:
            due_s, name = events.pop(0)
            address = station.input(name)
            closed = any(from_s <= due_s < to_s for pressed, from_s, to_s in times if pressed == address)
            if closed != station.control.inputs[address]:
                station.press(name, closed)
                say(f"{station.bench.time_s:8.3f} s  {name} {'on' if closed else 'off'}")
        station.run(PASS_NS * 1e-9)
        if scope is not None:
            station.draw(scope)
        now = station.shown()
        for name, value in now.items():
            if value != before[name]:
                say(f"{station.bench.time_s:8.3f} s  {name} {value}")
        before = now
    for name in station.axes:
        read = station.device(name).parameters
        values = ", ".join(f"{key} {read[key]}" for key in _REPORTED)
        say(f"{station.bench.time_s:8.3f} s  {name}: {values}")
    line = station.control.line
    say("the program is at its end" if line == 0 else f"the program is at line {line}")


def contactors_of(texts: Sequence[str]) -> dict[str, str]:
    """Read contactors, ``OUTPUT=DEVICE`` each; raises `InputError` if one is invalid or an output repeats."""
    found: dict[str, str] = {}
    for text in texts:
        output, _, device = text.partition("=")
        if not (output and device):
            raise InputError(f"--contactor is OUTPUT=DEVICE, as ofMotorX=AxisX, not {text!r}")
        if output in found:
            raise InputError(f"--contactor gives the output {output} twice")
        found[output] = device
    return found


def press_of(text: str) -> Press:
    """Read ``NAME=FROM:TO``, times in s; raises `InputError` if it is invalid."""
    name, _, times = text.partition("=")
    try:
        start, stop = (float(part) for part in times.split(":"))
    except ValueError:
        start, stop = 0.0, 0.0
    if not (name and 0 <= start < stop):
        raise InputError(f"--press is NAME=FROM:TO in s, as ifStart=0.5:0.6, not {text!r}")
    return Press(name, start, stop)
