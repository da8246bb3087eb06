"""Machine: every constant of one set-up, read from `models/` and checked.

Each constant in the TOML files is a table ``{ value, source, range }``: the source is a publication or the word
"ours"; values can be drawn from the range, if one is known.
"""

from __future__ import annotations

import hashlib
import math
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, TypeVar

from pydantic import ValidationError

from edmsim import models
from edmsim.errors import InputError, one_of, refuse_unknown, refused_entry, refuses_wrong_types
from edmsim.files import read_text
from edmsim.machine.components import Base, Component, Constant, Generator, Material, SetUp, Wire
from edmsim.machine.options import USUAL_MACHINE, Choices, Kind, SetUpOptions, available, refusal, show
from edmsim.machine.ranges import sample, uncertain
from edmsim.machine.setting import check, check_pulses
from edmsim.numeric import finite

if TYPE_CHECKING:
    import numpy as np


# Files of a set-up: those under `models/` by name, users' own files by path.

_MOST_BYTES = 1_000_000
_Component = TypeVar("_Component", bound=Component)


def read(component: type[_Component], kind: Kind, name: str) -> _Component:
    """Read a component of a set-up by its name under `models/`, or from a user's TOML file.

    A file with ``like = "agiecut-dem15"`` takes its missing constants from this file of the package.
    """
    if name.endswith(".toml"):
        file, text = name, _own_file(name)
    else:
        file, text = f"models/{kind}/{name}.toml", _our_file(kind, name)
    try:
        return component.model_validate(_on_its_like(tomllib.loads(text), kind, file))
    except ValidationError as error:
        key, reason = refused_entry(error)
        raise InputError(f"key '{key}': {reason}" if key else reason, file) from None
    except (ValueError, RecursionError) as error:  # also for very long numbers and deeply nested brackets
        raise InputError(f"not valid TOML: {error}", file) from None


def _our_file(kind: Kind, name: str, referring_file: str | None = None) -> str:
    refuse_unknown("technology" if kind == "technologies" else kind[:-1], name, available(kind), referring_file)
    return (resources.files("edmsim.models") / kind / f"{name}.toml").read_text(encoding="utf-8")


def _on_its_like(data: dict[str, Any], kind: Kind, file: str) -> dict[str, Any]:
    """Return a file's entries merged into those of the package's file that it is ``like``, and so on."""
    like = data.pop("like", None)
    if like is None:
        return data
    below = tomllib.loads(_our_file(kind, str(like), file))
    return _overlaid(_on_its_like(below, kind, file), data)


def _overlaid(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return one file's entries merged over another's: whole constants, and entries outside sections."""
    sections = {
        key: {**below[key], **value}
        for key, value in above.items()
        if isinstance(value, dict) and isinstance(below.get(key), dict) and "value" not in value
    }
    return {**below, **above, **sections}


def own_mjcf(name: str, file: str) -> str:
    """Return the MJCF that a user's machine file names: the path of a file in its folder, or a package's name."""
    sibling = Path(file).absolute().parent / name
    if sibling.is_file():
        return str(sibling)
    if not (Path(models.__file__).parent / name).is_file():
        raise InputError(f"key 'model': there is no MJCF {name!r} in this file's folder or in edmsim", file)
    return name


def own_mjcf_text(model_file: str) -> str:
    """Return the text of a user's MJCF; empty for one of the package, which the version of edmsim identifies."""
    return Path(model_file).read_text(encoding="utf-8") if Path(model_file).is_absolute() else ""


def constants_digest(machine: Machine) -> str:
    """Return a digest of all constants and settings of a set-up, with a user's MJCF."""
    said = machine.model_dump_json() + own_mjcf_text(machine.base.model)
    return hashlib.sha256(said.encode()).hexdigest()[:16]


def mjcf_version(model_file: str) -> int:
    """Return a number that changes when a user's MJCF does; 0 for one of the package."""
    return Path(model_file).stat().st_mtime_ns if Path(model_file).is_absolute() else 0


def _own_file(name: str) -> str:
    with suppress(OSError, ValueError):  # reading it raises the error
        if Path(name).stat().st_size > _MOST_BYTES:
            raise InputError(f"this is not a file of constants: it is larger than {_MOST_BYTES / 1e6:g} MB", name)
    return read_text(name)


_Options = ParamSpec("_Options")


class _Load(Protocol[_Options]):
    """Type of `Machine.load` for type checkers: its keywords are those of the class that declares the options."""

    def __call__(self, name: str | Path = ..., *no: _Options.args, **options: _Options.kwargs) -> Machine: ...


def _loads(options: Callable[_Options, SetUpOptions]) -> Callable[[Callable[..., Machine]], _Load[_Options]]:
    return lambda load: show(load, SetUpOptions)


class Machine(SetUp):
    """A set-up: machine, wire, material, generator and the operator's choices.

    Build it with `Machine.load`; change one thing with ``machine.with_(height_mm=30)``.

    Attributes
    ----------
    name, wire_name, material_name, generator_name : str
        Files of the components under `models/`.
    wire_diameter_um : float
        20..400.
    tension : float
        Wire tension in newton.
    height_mm : float
        Greatest height of the workpiece. The guides have a clearance from it.
    t_on_us, t_period_us : float
        Setting of the pulse generator.

    The options of `load` are attributes, too; None if the files' constants apply.

    Examples
    --------
    >>> import edmsim
    >>> machine = edmsim.Machine.load(material="copper", height_mm=30)
    >>> machine.with_(tension=8.0).tension
    8.0
    """

    def __init__(self, *unnamed: object, **components: Any) -> None:
        if unnamed or not components:
            names = ", ".join(map(repr, unnamed[:1]))
            raise InputError(f"a machine is read from its files: edmsim.Machine.load({names})")
        super().__init__(**components)

    @staticmethod
    @_loads(SetUpOptions)
    def load(name: str | Path = USUAL_MACHINE, **options: Any) -> Machine:
        """Read a set-up and check it.

        Parameters
        ----------
        name : str or path
            A name under `models/machines`, or the path of your own TOML file.
        {options}

        Raises
        ------
        InputError
            If a name is unknown, a key is wrong or missing, or a setting cannot run.
        """
        if "machine" in options:
            raise InputError(f"the machine is the first argument: Machine.load({str(options['machine'])!r})")
        try:
            chosen = SetUpOptions.model_validate(options)
        except ValidationError as error:
            raise refusal(error, SetUpOptions, "a set-up") from None
        name = str(name)
        wire_name, wire, diameter = read_wire(chosen.wire)
        generator = read(Generator, "generators", chosen.generator)
        base, material = read(Base, "machines", name), read(Material, "materials", chosen.material)
        if name.endswith(".toml"):
            base = base.model_copy(update={"model": own_mjcf(base.model, name)})
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
        """Return a checked copy with other choices: tension, height, diameter, pulses, or a later option of `load`.

        None restores the files' constant of an option after ``t_period_us``; the other choices need a number.
        """
        known = ("tension", "height_mm", "t_on_us", "t_period_us", "wire_diameter_um", *Choices.model_fields)
        for name in changes:
            if name not in known:
                raise InputError(f"a machine has no choice {name!r} to change; there are: {one_of(name, known)}")
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

    @refuses_wrong_types
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
        """Return the present arguments of `load` in place of all constants, of which a machine has hundreds."""
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
    """Return an operator's choice as a set-up stores it; only those that override a constant may be None."""
    unset = value is None and name in Choices.model_fields
    return value if unset or name == "pulse_shape" else finite(name, value)


def read_wire(chosen: str) -> tuple[str, Wire, float]:
    """Return name, constants and diameter in um of a wire, named as ``brass-254`` or by your own file."""
    name, diameter = _split_wire(chosen)
    wire = read(Wire, "wires", name)
    return name, wire, wire.default_diameter_um.value if diameter is None else diameter


def _split_wire(wire: str) -> tuple[str, float | None]:
    name, dash, diameter = wire.rpartition("-")
    if wire.endswith(".toml") or not dash:
        return wire, None
    try:
        return name, float(diameter)
    except ValueError:
        return wire, None
