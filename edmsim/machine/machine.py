"""Machine: every constant of one set-up, read from `models/` and checked.

Each constant in the TOML files is a table ``{ value, source, range }``: the source is a publication or the
word "ours"; the range, where one is known, is what `value` may be drawn from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol

from pydantic import ValidationError

from edmsim.errors import InputError
from edmsim.machine.files import read, read_base
from edmsim.machine.options import USUAL_MACHINE, Choices, SetUpOptions, refusal, show
from edmsim.machine.parts import Constant, Generator, Material, SetUp, Wire
from edmsim.machine.ranges import sample, uncertain
from edmsim.machine.setting import check, check_pulses
from edmsim.numeric import finite

if TYPE_CHECKING:
    import numpy as np


_Options = ParamSpec("_Options")


class _Load(Protocol[_Options]):
    """What type checkers know of `Machine.load`: its keywords are those of the class that declares the options."""

    def __call__(self, name: str = ..., *no: _Options.args, **options: _Options.kwargs) -> Machine: ...


def _loads(options: Callable[_Options, SetUpOptions]) -> Callable[[Callable[..., Machine]], _Load[_Options]]:
    def shown(load: Callable[..., Machine]) -> _Load[_Options]:
        show(load, SetUpOptions)
        return load

    return shown


class Machine(SetUp):
    """A set-up: machine, wire, material, generator and the operator's choices.

    Build it with `Machine.load`; change one thing with ``machine.with_(height_mm=30)``.

    Attributes
    ----------
    name, wire_name, material_name, generator_name : str
        Files of the parts under `models/`.
    wire_diameter_um : float
        20..400.
    tension : float
        Wire tension in newton.
    height_mm : float
        Greatest height of the workpiece. The guides have a clearance from it.
    t_on_us, t_period_us : float
        Setting of the pulse generator.

    The options of `load` are attributes, too; None if the files' constants apply.
    """

    @staticmethod
    @_loads(SetUpOptions)
    def load(name: str = USUAL_MACHINE, **options: Any) -> Machine:
        """Read a set-up and check it.

        Parameters
        ----------
        name : str
            A name under `models/machines`, or the path of your own TOML file.
        {options}

        Raises
        ------
        InputError
            If a name is unknown, a key is wrong or missing, or a setting cannot run.
        """
        try:
            chosen = SetUpOptions.model_validate(options)
        except ValidationError as error:
            raise refusal(error, SetUpOptions, "a set-up") from None
        wire_name, diameter = _split_wire(chosen.wire)
        wire, generator = read(Wire, "wires", wire_name), read(Generator, "generators", chosen.generator)
        base, material = read_base(name), read(Material, "materials", chosen.material)
        diameter = wire.default_diameter_um.value if diameter is None else diameter
        usual_tension = wire.stress_MPa.value * (math.pi / 4 * (diameter * 1e-3) ** 2)
        machine = Machine(
            name=name, wire_name=wire_name, material_name=chosen.material, generator_name=chosen.generator,
            base=base, wire=wire, material=material, generator=generator, wire_diameter_um=diameter,
            tension=usual_tension if chosen.tension is None else chosen.tension, height_mm=chosen.height_mm,
            t_on_us=generator.t_on_us.value if chosen.t_on_us is None else chosen.t_on_us,
            t_period_us=generator.t_period_us.value if chosen.t_period_us is None else chosen.t_period_us,
            **{choice: getattr(chosen, choice) for choice in Choices.model_fields},
        )
        machine.check()
        return machine

    def with_(self, **changes: float | str | None) -> Machine:
        """Return a checked copy with other choices: tension, height, diameter, or an option of `load`.

        None restores the files' constant, if any.
        """
        known = {"tension", "height_mm", "t_on_us", "t_period_us", "wire_diameter_um", *Choices.model_fields}
        unknown = set(changes) - known
        if unknown:
            raise InputError(f"Machine.with_ does not know {', '.join(sorted(unknown))}")
        machine = self.model_copy(update={name: _checked(name, value) for name, value in changes.items()})
        machine.check()
        return machine

    def with_pulses(self, t_on_us: float, t_period_us: float) -> Machine:
        """Return a copy with another pulse setting; only the pulses are checked, which is faster than `with_`."""
        pulses = {"t_on_us": finite("t_on_us", t_on_us), "t_period_us": finite("t_period_us", t_period_us)}
        machine = self.model_copy(update=pulses)
        check_pulses(machine)
        return machine

    def uncertain(self) -> dict[str, Constant]:
        """Return the constants of machine, wire and material that have a range.

        Names have section and key: ``"gap.critical_um"``, ``"wire.strength_MPa"``. The generator's ranges are not
        included: they limit settings.
        """
        return uncertain(self)

    def sample(self, rng: np.random.Generator, only: Iterable[str] | None = None) -> Machine:
        """Draw a machine within the ranges of its uncertain constants.

        Each constant is drawn independently: log-uniformly if its range is positive and spans a factor of 3 or more,
        otherwise uniformly. The operator's choices do not change. A set-up that `check` rejects, for example because
        the wire cannot hold the tension, is drawn again.

        Parameters
        ----------
        rng : numpy.random.Generator
            The same state gives the same machine. The drawn value of a constant does not depend on `only`, unless a
            set-up had to be drawn again.
        only : iterable of str, optional
            Sections (``"gap"``) and constants (``"dielectric.conductivity_uS_cm"``) to draw; by default all of
            `uncertain`. The others do not change.

        Returns
        -------
        Machine
            Checked, with the same sources and ranges.

        Raises
        ------
        InputError
            If a name is unknown, a constant has no range, or no drawn set-up can run.
        """
        return sample(self, rng, only)

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        """Say the arguments of `load` that are in force, in place of every constant: a machine has hundreds."""
        yield None, self.name
        yield "material", self.material_name
        yield "wire", self.wire_name
        yield "generator", self.generator_name
        for name in ("wire_diameter_um", "height_mm", "tension", "t_on_us", "t_period_us"):
            yield name, float(f"{getattr(self, name):.6g}")
        yield from ((name, value) for name in Choices.model_fields if (value := getattr(self, name)) is not None)

    def check(self) -> None:
        """Raise `InputError` for a set-up that cannot run."""
        check(self)


def _checked(name: str, value: float | str | None) -> float | str | None:
    """Return an operator's choice as a set-up keeps it; only those that stand in for a constant may be None."""
    unset = value is None and name in Choices.model_fields
    return value if unset or name == "pulse_shape" else finite(name, value)


def _split_wire(wire: str) -> tuple[str, float | None]:
    name, dash, diameter = wire.rpartition("-")
    if wire.endswith(".toml") or not dash:
        return wire, None
    try:
        return name, float(diameter)
    except ValueError:
        return wire, None
