"""The control: it executes a program pass by pass, on devices, inputs and outputs.

A pass ends at the next WAIT, whose condition is checked once a pass (ours: the manual does not define how tasks
alternate). A read of a device with a pending command first executes that command (manual 1.4.4). Set a timer to a
time in ms; it reads 1 when the time is over, else 0 (ours).
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Protocol

from edmsim.controllers.qcl.configuration import Configuration, Variable
from edmsim.controllers.qcl.program import Expression, QclProgram
from edmsim.errors import InputError

LONGEST_PASS = 10_000  # statements of a pass at most (ours): a loop without WAIT gives the others their turn, too


LONGEST_MS = 2**31 - 1  # a timer's time at most (ours: a long)


class Device(Protocol):
    """The control's view of a device."""

    @property
    def parameters(self) -> MutableMapping[str, int]:
        """Parameters by name."""

    @property
    def states(self) -> Mapping[str, bool]:
        """States by name."""

    @property
    def pending(self) -> bool:
        """Whether a command waits for the next sample."""

    def command(self, name: str) -> None:
        """Give a command."""


class _WaitsFor(Exception):
    """A device has to take its sample before it can be read."""


class Control:
    """A control with a program.

    Parameters
    ----------
    configuration : Configuration
    program : QclProgram
        A program for this configuration.
    devices : mapping of str to Device
        Devices by their configured names, in lower case.

    Attributes
    ----------
    variables : dict of str to int
        Values by name, in lower case.
    data : dict of (str, int, int) to int
        Values of data groups by name, recipe and step; the step is 0 if the variable has no steps. Missing values
        are 0.
    now_ms : int
        The control's clock for timers; the caller sets it.
    inputs, outputs : dict of str to bool
        By slot address.
    line : int
        Line of the next statement, 0 after the end.
    """

    def __init__(
        self, configuration: Configuration, program: QclProgram, devices: Mapping[str, Device] | None = None
    ) -> None:
        self._configuration, self._program = configuration, program
        self._devices = dict(devices or {})
        self.variables = dict.fromkeys(configuration.variables, 0)
        self.data: dict[tuple[str, int, int], int] = {}
        self.now_ms = 0
        self._over_ms: dict[str, int] = {}
        self.inputs = dict.fromkeys(configuration.inputs.values(), False)
        self.outputs = dict.fromkeys(configuration.outputs.values(), False)
        self._next = 0

    @property
    def line(self) -> int:
        """Line of the next statement, 0 after the end."""
        statements = self._program.statements
        return statements[self._next].line if self._next < len(statements) else 0

    def restart(self) -> None:
        """Restart as at power-up; SYSTEM variables and data groups keep their values."""
        for name, variable in self._configuration.variables.items():
            if not variable.retained:
                self.variables[name] = 0
        self.outputs = dict.fromkeys(self.outputs, False)
        self._over_ms.clear()
        self._next = 0

    def run_pass(self) -> str | None:
        """Execute statements until the pass ends.

        Returns
        -------
        str or None
            Device that must run a sample before this pass can continue; None at the end of the pass.

        Raises
        ------
        InputError
            A division by zero, or a value out of its variable's range; the error names the line.
        """
        statements = self._program.statements
        for _ in range(LONGEST_PASS):
            if self._next >= len(statements) or statements[self._next].verb == "end":
                self._next = len(statements)
                return None
            line, verb, target, value, to, at = statements[self._next]
            try:
                if verb == "wait":
                    self._next += 1 if self._value(value) else 0
                    return None
                if verb == "assign":
                    self._assign(target, at, self._value(value))
                elif verb == "command":
                    self._devices[target[0]].command(target[1])
                leads = verb == "jump" or (verb == "if" and not self._value(value))
                self._next = to if leads else self._next + 1
            except _WaitsFor as device:
                return str(device)
            except InputError as error:
                raise InputError(f"line {line}: {error}") from None
        return None

    def _assign(self, target: tuple[str, ...], at: tuple[Expression, ...], value: int) -> None:
        found = self._configuration
        if len(target) == 2:
            self._devices[target[0]].parameters[target[1]] = value
        elif at:
            self.data[self._place(target[0], at)] = _fitting(found.data[target[0]].variable, value)
        elif target[0] in found.timers:
            if not 0 <= value <= LONGEST_MS:
                raise InputError(f"the timer {target[0]} cannot run for {value} ms; it must be 0 to {LONGEST_MS}")
            self._over_ms[target[0]] = self.now_ms + value
        elif target[0] in self._configuration.outputs:
            self.outputs[self._configuration.outputs[target[0]]] = value != 0
        else:
            self.variables[target[0]] = _fitting(found.variables[target[0]], value)

    def _place(self, name: str, at: tuple[Expression, ...]) -> tuple[str, int, int]:
        """Return name, recipe and step of a data group's variable."""
        found = self._configuration.data[name]
        recipe, step = [*(self._value(part) for part in at), 0][:2]
        for what, number, most in (("recipe", recipe, found.recipes), ("step", step, found.steps)):
            if most and not 1 <= number <= most:
                raise InputError(f"{name} has no {what} {number}; it must be 1 to {most}")
        return name, recipe, step

    def _value(self, expression: Expression) -> int:
        kind = str(expression[0])
        if kind == "number":
            return int(expression[1])  # type: ignore[arg-type]
        if kind == "name":
            return self._named(str(expression[1]))
        if kind == "member":
            return self._member(str(expression[1]), str(expression[2]))
        if kind == "element":
            return self.data.get(self._place(str(expression[1]), expression[2:]), 0)  # type: ignore[arg-type]
        values = [self._value(part) for part in expression[1:]]  # type: ignore[arg-type]
        if kind == "NOT":
            return int(not values[0])
        return _operate(kind, *values)

    def _named(self, name: str) -> int:
        found = self._configuration
        if name in found.constants:
            return found.constants[name]
        if name in found.inputs:
            return int(self.inputs[found.inputs[name]])
        if name in found.outputs:
            return int(self.outputs[found.outputs[name]])
        if name in found.timers:
            return int(self.now_ms >= self._over_ms.get(name, 0))
        return self.variables[name]

    def _member(self, device: str, member: str) -> int:
        if self._devices[device].pending:
            raise _WaitsFor(device)
        found = self._devices[device]
        return int(found.states[member] if member.startswith("st_") else found.parameters[member])


def _fitting(variable: Variable, value: int) -> int:
    """Return a value if it fits into a variable."""
    least, greatest = variable.limits
    if not least <= value <= greatest:
        raise InputError(f"{variable.name} cannot hold {value}; it must be {least} to {greatest}")
    return value


def _operate(kind: str, left: int, right: int) -> int:
    """Apply an operator to two whole numbers; a quotient is truncated (row Q-82)."""
    if kind == "/":
        if right == 0:
            raise InputError(f"{left} is divided by nought")
        return abs(left) // abs(right) * (1 if (left < 0) == (right < 0) else -1)
    results = {
        "+": left + right, "-": left - right, "*": left * right, "AND": int(bool(left and right)),
        "OR": int(bool(left or right)), "EQ": int(left == right), "NE": int(left != right), "LT": int(left < right),
        "GT": int(left > right), "LE": int(left <= right), "GE": int(left >= right),
    }  # fmt: skip
    return results[kind]
