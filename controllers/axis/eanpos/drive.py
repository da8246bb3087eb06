"""QEM EANPOS, an analogue positioner: ramps, a loop over an encoder, a reference voltage of 16 bits, homing.

Its registers, commands and states are the manual's (`registers`). `sample` runs a sample with commands and homing, by
the motions of `moves`. Its constants, and settings that the manual does not define, are in
``models/drives/eanpos.toml``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import HOLDS_OUTPUT, SampleFunction
from edmsim.controllers.axis.drive import PowersUp, Screw, axis_row, new_record, restart
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.controllers.axis.eanpos.moves import warn
from edmsim.controllers.axis.eanpos.sample import eanpos_sample, start_refused
from edmsim.controllers.axis.servo_chip import Registers, by_name
from edmsim.errors import InputError, methods_refuse_wrong_types
from edmsim.numeric import whole

ALIASES = {
    "prsdir": "prmdir", "prsvvel": "prsvel", "sprsvvel": "sprsvel", "feedforward": "feedfw", "folterr": "follerr",
    "integreg": "integ", "st_follower": "st_foller",
}  # fmt: skip
"""Other names of the manual (row Q-A8). Names are compared without case (row Q-A35)."""
_SIZES = {"L": (-(2**31), 2**31 - 1), "W": (-(2**15), 2**16 - 1), "B": (-(2**7), 2**8 - 1)}
"""Ranges of a long, a word and a byte, signed or not."""
_TABLE: dict[str, dict[str, Any]] = {entry["name"]: entry for entry in at.DATA["parameter"]}
_RETAINED = [k for k, name in enumerate(at.PARAMETERS) if _TABLE[name]["retained"]]
_ERRORS = {
    at.CAM_NOT_FOUND: "no cam was found", at.MARK_NOT_FOUND: "no zero pulse was found",
    at.OUTPUT_TAKEN: "two devices write to one output", at.BAD_RESOLUTION: "measure / pulse is out of range",
    at.RESOURCE_MISSING: "a resource for prsmode is not declared",
}  # fmt: skip
_SIGNALS = {
    "setpos": at.NEW_SETPOS, "setvel": at.NEW_SETVEL, "posit": at.NEW_POSIT, "rampmode": at.NEW_RAMPS,
    "taccdec": at.NEW_RAMPS, "tacc": at.NEW_RAMPS, "tdec": at.NEW_RAMPS, "measure": at.NEW_RESOLUTION,
    "pulse": at.NEW_RESOLUTION,
}  # fmt: skip
"""Parameters whose new value a sample must apply, with their bits of `WRITTEN`."""


class Resources(NamedTuple):
    """Resources of a device on the bus, from the configuration; row Q-A21 lists what changes if one is missing."""

    counter: bool = True  # a bidirectional counter; without it, the theoretical position is the actual one
    interrupt: bool = True  # an interrupt line for the encoder's zero pulse, for homing in mode 1
    home_input: bool = True  # the input that enables the zero pulse: the cam
    output: bool = True  # an analogue output; without it, no motor is driven


class Parameters(Registers):
    """The 45 parameters of a device by the manual's names.

    A value outside the manual's limits is accepted with warning 3. A value written while its condition is not met
    is ignored with warning 2 (both ours; ``wrnvalue`` is the parameter's number).

    Raises
    ------
    InputError
        A name is unknown, or a value is not a whole number that fits into the parameter's size.
    """

    OWNER = "device"

    def __init__(self, owner: Eanpos) -> None:
        super().__init__(owner, {name: (k, *_SIZES[_TABLE[name]["size"]]) for k, name in enumerate(at.PARAMETERS)})

    def __setitem__(self, name: str, value: float) -> None:
        name, value = parameter_name(name), self.fitting(name, value)
        entry, reg, (place, *_) = _TABLE[name], self._reg, self._place(name)
        if not all(_holds(reg, condition) for condition in entry["write"]):
            warn(reg, at.NOT_WRITTEN, place)
            return
        least, greatest = (self[limit] if isinstance(limit, str) else limit for limit in entry["limits"])
        if not least <= value <= greatest:
            warn(reg, at.OUT_OF_LIMITS, place)
        if name == "pulse" and value > 0:
            _count_in(reg, value)
        reg[place] = value
        reg[at.WRITTEN] |= _SIGNALS.get(name, 0)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and _plain(name) in at.PARAMETERS

    def _place(self, name: str) -> tuple[int, int, int]:
        return super()._place(parameter_name(name))


class States(Mapping[str, bool]):
    """The 19 states of a device by the manual's names, after the last sample."""

    def __init__(self, owner: Eanpos) -> None:
        self._owner = owner

    def __getitem__(self, name: str) -> bool:
        return bool(self._owner.record["reg"][0, at.FIRST_STATE + at.STATES.index(state_name(name))])

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and _plain(name) in at.STATES

    def __iter__(self) -> Iterator[str]:
        return iter(at.STATES)

    def __len__(self) -> int:
        return len(at.STATES)


def parameter_name(name: str) -> str:
    """Return a parameter's name, from any case and from the manual's other names."""
    return _known(name, at.PARAMETERS, "parameter")


def state_name(name: str) -> str:
    """Return the name of a state; see `parameter_name`."""
    return _known(name, at.STATES, "state")


def _plain(name: str) -> str:
    return ALIASES.get(name.lower(), name.lower())


def _known(name: str, names: tuple[str, ...], what: str) -> str:
    found = _plain(name)
    if found not in names:
        raise InputError(f"the device has no {what} {name!r}; it has {', '.join(names)}")
    return found


def _count_in(reg: NDArray[np.int64], pulse: int) -> None:
    """Convert the position's numerator, in units of 1 / pulse, to a new `pulse`."""
    posit, old = int(reg[at.POSIT]), int(reg[at.PULSE])
    fraction = (int(reg[at.NUMERATOR]) - posit * old) * pulse // old if old > 0 else 0
    reg[at.NUMERATOR] = posit * pulse + fraction


def _holds(reg: NDArray[np.int64], condition: str) -> bool:
    """Return whether a condition for a write, of the manual's table, is met."""
    fulfilled = {
        "still": reg[at.ST_STILL] == 1, "unhomed": reg[at.ST_PRSON] == 0, "epicycloid": reg[at.RAMPTYPE] == 1,
        "calibration": reg[at.ST_CAL] == 1, "never": False,
    }  # fmt: skip
    return bool(fulfilled[condition])


@methods_refuse_wrong_types
class Eanpos(PowersUp):
    """A positioner on an axis.

    Parameters
    ----------
    motor : record array (1,), optional
        Axis with velocity amplifier (`edmsim.controllers.axis.drive.axis_row`); by default ``analogue``.
    tcamp_ms : int, optional
        Sample time, 1 to 255 ms; by default that of the manual's example.
    resources : Resources, optional
        Resources from the configuration; by default all.
    parameters : mapping of str to int, optional
        Values in its retentive memory, by the manual's names.
    settings : mapping of str to int, optional
        Overrides of the table ``settings`` of ``models/drives/eanpos.toml``, which the manual does not define.

    Attributes
    ----------
    parameters : Parameters
    states : States
    settings : mapping of str to int

    Raises
    ------
    InputError
        The sample time is out of range, or a name or a value is invalid.

    Examples
    --------
    >>> device = Eanpos(parameters={"measure": 10000, "pulse": 40000})
    >>> device.parameters["pulse"], device.states["st_still"]
    (40000, True)
    """

    name = "eanpos"
    makes_ramps = True
    sample: SampleFunction = eanpos_sample

    def __init__(
        self, motor: NDArray[np.void] | None = None, tcamp_ms: int | None = None, resources: Resources | None = None,
        parameters: Mapping[str, float] | None = None, settings: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        self.motor: NDArray[np.void] | None = axis_row("analogue") if motor is None else motor
        tcamp = at.DEVICE["tcamp_ms"] if tcamp_ms is None else tcamp_ms
        if whole(tcamp) is None or not 1 <= tcamp <= at.DEVICE["greatest_tcamp_ms"]:
            raise InputError(f"TCamp is {tcamp} ms; it must be 1 to {at.DEVICE['greatest_tcamp_ms']}")
        self.record: NDArray[np.void] = new_record((tcamp * 1_000_000, 1))
        self.record["index_ns"], self.record["lines"] = at.DEVICE["index_ns"], HOLDS_OUTPUT
        reg = self.record["reg"][0]
        reg[: len(at.PARAMETERS)] = [entry["value"] for entry in at.DATA["parameter"]]
        reg[at.TCAMP_NS] = self.record["num"][0]
        reg[at.RESOURCES] = sum(bit for bit, present in zip(_BITS, resources or Resources(), strict=True) if present)
        reg[at.FRESH] = reg[at.ST_STILL] = 1
        first = at.FIRST_SETTING
        self.settings = Registers(self, {name: (first + k, 0, 2**31) for k, name in enumerate(at.SETTINGS)})
        self.settings.update({**at.DATA["settings"], **(settings or {})})
        self.parameters = Parameters(self)
        self.states = States(self)
        for name, value in (parameters or {}).items():
            reg[at.PARAMETERS.index(parameter_name(name))] = self.parameters.fitting(name, value)
        self._switch_on()

    def _switch_on(self) -> None:
        if self.settings["starts_in_loop"]:
            self.command("INIT")
            self.command("LOOPON")

    @classmethod
    def tuned(
        cls, axis: str = "analogue-table", changes: Mapping[str, float] = MappingProxyType({}),
        screw: Screw | None = None,
    ) -> Self:
        """Return a device commissioned for motor steps: its first samples initialise it and close the loop.

        Parameters
        ----------
        axis : str
        changes : mapping of str to int
            Overrides by name.
        screw : Screw, optional
            The machine's screw, instead of the axis' own with steps of 2 um: ``measure`` is then the travel of an
            encoder turn in um, and ``maxvel`` the speed at 10 V.

        Raises
        ------
        InputError
            No tuning exists for that axis, or a parameter is unknown.
        """
        if axis not in at.DATA["tuned"]:
            raise InputError(f"no EANPOS is tuned for an axis {axis!r}; there are: {', '.join(at.DATA['tuned'])}")
        motor, found = axis_row(axis), {**at.DATA["tuned"][axis]}
        screw = screw or Screw(_TUNED_STEP_UM, float(motor["um_per_rad"][0]))
        share = screw.um_per_rad / float(motor["um_per_rad"][0])
        found |= {name: round(found[name] * share) for name in ("measure", "maxvel")}
        settings = {"follow_step": round(screw.step_um), "starts_in_loop": 1}
        changed = by_name(changes, parameter_name, Parameters.OWNER)
        return cls(motor, 1, parameters={**found, **changed}, settings=settings)

    def command(self, name: str) -> None:
        """Write a command to the mailbox; the next sample executes it.

        Raises
        ------
        InputError
            The command is unknown.
        """
        if name.upper() not in at.COMMANDS:
            raise InputError(f"the device has no command {name!r}; it has {', '.join(at.COMMANDS)}")
        self.record["reg"][0, at.MAILBOX] |= 1 << at.COMMANDS.index(name.upper())

    @property
    def pending(self) -> bool:
        """Whether a command waits for the next sample."""
        return bool(self.record["reg"][0, at.MAILBOX])

    @property
    def output_V(self) -> float:
        """Voltage at the analogue output after the last sample."""
        return float(self.record["command"][0]) * 10.0

    @property
    def theoretical(self) -> tuple[float, float]:
        """Theoretical position (units of measure) and speed (units per s) at the last sample."""
        real = self.record["real"][0]
        return float(real[at.THEORY]), float(real[at.SPEED])

    def home(self) -> None:
        """Search the reference point (PLCopen MC_Home): PRESET."""
        self.command("PRESET")

    def move_absolute(self, position: int, velocity: int) -> None:
        """Move to a position (MC_MoveAbsolute): setvel, setpos, START; in motion it changes both."""
        self.parameters["setvel"], self.parameters["setpos"] = velocity, position
        if self.states["st_still"]:
            self.command("START")

    def move_velocity(self, velocity: int, forward: bool = True) -> None:
        """Move until `halt` or the software limit (MC_MoveVelocity): setvel and MANFW or MANBW."""
        self.parameters["setvel"] = velocity
        self.command("MANFW" if forward else "MANBW")

    def halt(self) -> None:
        """Stop on the ramp (MC_Halt): STOP."""
        self.command("STOP")

    def stop(self) -> None:
        """Stop without a ramp and stay locked until `power` (MC_Stop): EMRG."""
        self.command("EMRG")

    def power(self, on: bool = True) -> None:
        """Close the position loop and leave the emergency state (MC_Power), or open the loop."""
        if on and self.states["st_emrg"]:
            self.command("RESUME")
        self.command("LOOPON" if on else "LOOPOFF")

    def set_position(self, position: int) -> None:
        """Set the axis' count to a position (MC_SetPosition): posit."""
        self.parameters["posit"] = position

    def reset(self) -> None:
        """Clear an error (MC_Reset): RSERR."""
        self.command("RSERR")

    @property
    def counts_per_step(self) -> float:
        """Encoder edges per step, if it follows steps: a step changes setpos by `follow_step`."""
        reg = self.record["reg"][0]
        if reg[at.MEASURE] == 0:
            return 0.0
        direction = -1 if reg[at.ST_CNTREV] else 1
        return float(direction * reg[at.FOLLOW_STEP] * reg[at.PULSE] / reg[at.MEASURE])

    def why_stopped(self) -> str:
        """Return the error, following error or refused command that stops it or keeps it from its target."""
        p, reg = self.parameters, self.record["reg"][0]
        if self.states["st_error"]:
            return f"its error {p['errcode']}: {_ERRORS[p['errcode']]}"
        if self.states["st_foller"]:
            return f"its following error passed maxfollerr, {p['maxfollerr']} edges"
        if start_refused(reg):
            return "it refused its command START"
        if self.states["st_emrg"]:
            return "it is in emergency"
        if not p["minpos"] <= reg[at.FOLLOWED] <= p["maxpos"]:
            return f"its target {reg[at.FOLLOWED]} lies beyond minpos {p['minpos']} or maxpos {p['maxpos']}"
        if slow := [name for name in ("setvel", "maxvel") if p[name] <= 0]:
            return f"its {' and '.join(slow)} is 0"
        return f"its warning {p['wrncode']} of {p['wrnvalue']}" if self.states["st_warning"] else ""

    def power_up(self) -> bytes:
        """Restart as at power-up; retentive parameters and st_cntrev keep their values (row Q-56)."""
        fresh = Eanpos(self.motor, int(self.record["num"][0]) // 1_000_000)
        old, reg = self.record["reg"][0], fresh.record["reg"][0]
        keep = [*_RETAINED, at.ST_CNTREV, at.RESOURCES, *range(at.FIRST_SETTING, at.FIRST_SETTING + len(at.SETTINGS))]
        reg[keep] = old[keep]
        restart(self.record, fresh.record)
        self._switch_on()
        return b""


_TUNED_STEP_UM = 2.0  # motor step of the machine for which devices are tuned
_BITS = (at.HAS_COUNTER, at.HAS_INDEX, at.HAS_HOME, at.HAS_OUTPUT)
