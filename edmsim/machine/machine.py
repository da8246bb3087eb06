"""Machine: every constant of one set-up, read from `models/` and checked.

Each constant in the TOML files is a table ``{ value, source, range }``: the source is a publication or the
word "ours"; the range, where one is known, is what `value` may be drawn from.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from edmsim.errors import InputError
from edmsim.machine.files import read, read_base
from edmsim.machine.parts import Choices, Constant, Generator, Material, SetUp, Wire
from edmsim.machine.ranges import sample, uncertain
from edmsim.machine.setting import check, check_pulses
from edmsim.numeric import finite

if TYPE_CHECKING:
    import numpy as np


class Machine(SetUp):
    """One set-up, complete: machine, wire, material, generator and the operator's choices.

    Build it with `Machine.load`; change one thing with ``machine.with_(height_mm=30)``.

    Attributes
    ----------
    name, wire_name, material_name, generator_name : str
        Files under `models/` the parts were read from.
    wire_diameter_um : float
        20..400.
    tension : float
        Wire tension in newton.
    height_mm : float
        Workpiece height; the greatest one, if it changes. The guides stand off it.
    t_on_us, t_period_us : float
        Setting of the pulse generator.
    open_voltage_V, peak_current_A, resistance_ohm, ignition_wait_us, pulse_shape, wire_speed_m_s, \
    flushing_lower_Pa, flushing_upper_Pa, standoff_lower_mm, standoff_upper_mm : float, str or None
        What the operator sets in place of the files' constants, None where they hold; see `load`.
    """

    @classmethod
    def load(
        cls,
        name: str = "agiecut-dem15",
        *,
        material: str = "tool-steel",
        wire: str = "brass",
        generator: str = "iso-pulse",
        height_mm: float = 20.0,
        tension: float | None = None,
        t_on_us: float | None = None,
        t_period_us: float | None = None,
        open_voltage_V: float | None = None,
        peak_current_A: float | None = None,
        resistance_ohm: float | None = None,
        ignition_wait_us: float | None = None,
        pulse_shape: str | None = None,
        wire_speed_m_s: float | None = None,
        flushing_lower_Pa: float | None = None,
        flushing_upper_Pa: float | None = None,
        standoff_lower_mm: float | None = None,
        standoff_upper_mm: float | None = None,
    ) -> Machine:
        """Read a set-up and check it.

        Parameters
        ----------
        name, material, generator : str
            A name under `models/`, or the path of an own TOML file.
        wire : str
            Name or path, optionally with a diameter in um: ``"brass"``, ``"copper-100"``.
        height_mm : float
            Workpiece height, 0.5..400 mm.
        tension : float, optional
            Newton; the wire's default stress if not given.
        t_on_us, t_period_us : float, optional
            Generator setting; the generator's own if not given.
        open_voltage_V : float, optional
            Voltage until ignition, within the generator's range, or 10..500 V if its file has none. It drives the
            discharge, too, where the generator has no supply of its own for that.
        peak_current_A : float, optional
            Peak current of a discharge: at most what the supply drives through the generator's own resistor.
        resistance_ohm : float, optional
            Resistor in place of the generator's, 0.01..10 000 ohm; not together with `peak_current_A`.
        ignition_wait_us : float, optional
            Longest wait for ignition, 0.1..10 000 us; not for an iso-pulse generator, which has none.
        pulse_shape : {"rectangle", "triangle"}, optional
            Shape of the current; a triangle not for an iso-pulse generator, which would cut it off.
        wire_speed_m_s : float, optional
            Speed of the running wire, 0.001..15 m/s.
        flushing_lower_Pa, flushing_upper_Pa : float, optional
            Pressures of the two nozzles over the surroundings, 0 (off) to 3e6 Pa; the machine's own for both if not
            given.
        standoff_lower_mm, standoff_upper_mm : float, optional
            Distances of the two nozzles from the workpiece, 0..100 mm; 0, a nozzle that lies on it, if not given. Off
            the workpiece its water escapes sideways, and less of the pressure is left.

        Raises
        ------
        InputError
            Unknown name (which exist is said), a wrong or missing key, or a setting that cannot run.
        """
        wire_name, diameter = _split_wire(wire)
        base, wire_, material_, generator_ = (
            read_base(name),
            read(Wire, "wires", wire_name),
            read(Material, "materials", material),
            read(Generator, "generators", generator),
        )
        diameter = wire_.default_diameter_um.value if diameter is None else diameter
        area_mm2 = math.pi / 4 * (diameter * 1e-3) ** 2
        machine = cls(
            name=name, wire_name=wire_name, material_name=material, generator_name=generator,
            base=base, wire=wire_, material=material_, generator=generator_,
            wire_diameter_um=diameter,
            tension=wire_.stress_MPa.value * area_mm2 if tension is None else tension,
            height_mm=height_mm,
            t_on_us=generator_.t_on_us.value if t_on_us is None else t_on_us,
            t_period_us=generator_.t_period_us.value if t_period_us is None else t_period_us,
            open_voltage_V=open_voltage_V, peak_current_A=peak_current_A, resistance_ohm=resistance_ohm,
            ignition_wait_us=ignition_wait_us, pulse_shape=pulse_shape, wire_speed_m_s=wire_speed_m_s,
            flushing_lower_Pa=flushing_lower_Pa, flushing_upper_Pa=flushing_upper_Pa,
            standoff_lower_mm=standoff_lower_mm, standoff_upper_mm=standoff_upper_mm,
        )
        machine.check()
        return machine

    def with_(self, **changes: float | str | None) -> Machine:
        """Return a copy with other operator's choices, checked: tension, height, diameter, or a setting of `load`.

        None puts the files' constant in force again where there is one.
        """
        known = {"tension", "height_mm", "t_on_us", "t_period_us", "wire_diameter_um", *Choices.model_fields}
        unknown = set(changes) - known
        if unknown:
            raise InputError(f"Machine.with_ does not know {', '.join(sorted(unknown))}")
        machine = self.model_copy(update={name: _checked(name, value) for name, value in changes.items()})
        machine.check()
        return machine

    def with_pulses(self, t_on_us: float, t_period_us: float) -> Machine:
        """Return a copy with another setting of the pulses; only they are checked, so it takes a fifth of `with_`."""
        pulses = {"t_on_us": finite("t_on_us", t_on_us), "t_period_us": finite("t_period_us", t_period_us)}
        machine = self.model_copy(update=pulses)
        check_pulses(machine)
        return machine

    def uncertain(self) -> dict[str, Constant]:
        """Return the constants of machine, wire and material that have a range.

        Their names are section and key: ``"gap.critical_um"``, ``"wire.strength_MPa"``. The ranges of the
        generator are not among them: they bound what an operator may set, not what is known.
        """
        return uncertain(self)

    def sample(self, rng: np.random.Generator, only: Iterable[str] | None = None) -> Machine:
        """Draw a machine within the ranges of its uncertain constants.

        Each constant is drawn by itself: log-uniformly where its range is positive and spans a factor of 3 or
        more, uniformly otherwise. The operator's choices stay, whatever is drawn of the constants in whose
        place they are. A set-up that `check` refuses, say because the wire drawn does not hold the tension, is
        drawn again, so the machines follow the ranges as far as these choices allow.

        Parameters
        ----------
        rng : numpy.random.Generator
            Same state, same machine. What one constant is drawn as does not depend on `only`, unless a
            set-up had to be drawn again.
        only : iterable of str, optional
            Sections (``"gap"``) and constants (``"dielectric.conductivity_uS_cm"``) to draw; the others keep
            their values. All by default; see `uncertain`.

        Returns
        -------
        Machine
            Checked; its constants keep their sources and ranges.

        Raises
        ------
        InputError
            An unknown name, or a constant without a range; or no set-up that can run was drawn.
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
