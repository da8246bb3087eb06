"""A cut in passes: what a technology says, put in place of the options that it decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from edmsim.controllers import from_text
from edmsim.cosim.passes import PassSetup
from edmsim.errors import InputError
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import with_overrides
from edmsim.machine.technology import (
    PassSetting,
    PassTable,
    Technology,
    machine_of,
    nearest_technology,
    read_technology,
)
from edmsim.program.outline import Program
from edmsim.program.passes import PassPlan
from edmsim.program.path import Conditions, CutPath

_OF_PASS = {
    "generator": "generator", "tension": "tension_N", "t_on_us": "t_on_us", "t_period_us": "t_period_us",
    "open_voltage_V": "open_voltage_V", "peak_current_A": "peak_current_A", "ignition_wait_us": "ignition_wait_us",
    "wire_speed_m_s": "wire_speed_m_s", "flushing_lower_Pa": "flushing_lower_Pa",
    "flushing_upper_Pa": "flushing_upper_Pa",
}  # fmt: skip
"""Options of a cut that a pass has of its own, and what the technology calls them."""

_Plan = Callable[[str | Path | Program, CutSettings, Sequence[Machine], PassPlan | None], CutPath]


class Passes(NamedTuple):
    """A cut as a technology sets it."""

    settings: CutSettings  # with the technology's machine, wire, planner and the setting of the rough pass
    path: CutPath
    setups: tuple[PassSetup, ...] = ()  # one per pass; none for a cut in one pass
    approach: PassSetup | None = None
    table: PassTable | None = None  # what the technology says
    technology: Technology | None = None


def with_passes(program: str | Path | Program, settings: CutSettings, plan: _Plan) -> Passes:
    """Plan a cut, in passes where the settings ask for some or the program has some."""
    if settings.passes is None:
        path = plan(program, settings, [settings.load_machine()], None)
        if path.conditions.settings:
            return _by_conditions(program, settings, path, plan)
        if path.passes == 1:
            if settings.technology is not None:
                raise InputError("a technology is for passes: say how many, as --passes 4")
            return Passes(settings, path)
        technology = _technology(settings)
        table = _table(settings, technology, path.passes)
        settings = in_force(settings, technology, table)
        own = PassPlan(table.offsets_mm, of_program=True)
        path = plan(program, settings, _machines(settings, technology, table), own)
        note = f"the program cuts an edge {path.passes} times: these are passes, with the settings of the technology "
        return _made(settings, technology, table, path, (f"{note}'{technology.title}'", *table.notices))
    if settings.offset == "none":
        raise InputError("passes run beside an edge at their offsets: offset none leaves nothing to trim")
    technology = _technology(settings)
    table = _table(settings, technology, settings.passes)
    shift_mm = 0.0 if settings.offset == "auto" else float(settings.offset) - table.offsets_mm[-1]
    offsets_mm = tuple(round(mm + shift_mm, 6) for mm in table.offsets_mm)
    after_tab: Any = settings.after_tab
    pass_plan = PassPlan(offsets_mm, settings.tab_mm, settings.overlap_mm, after_tab)
    settings = in_force(settings, technology, table)
    path = plan(program, settings, _machines(settings, technology, table), pass_plan)
    return _made(settings, technology, table, path, table.notices)


def _by_conditions(program: str | Path | Program, settings: CutSettings, path: CutPath, plan: _Plan) -> Passes:
    """Give every pass the settings that the user's table has for the program's condition."""
    if settings.technology is not None:
        raise InputError("a technology and a table of conditions both decide the passes: give one of them")
    of_passes = [_with_condition(settings, path.conditions, name) for name in path.conditions.names]
    setups = tuple(_setup(one) for one in of_passes)
    if path.leans:  # where a wire bends follows from the tension of each pass
        path = plan(program, of_passes[0], [one.machine for one in setups], None)
    if path.passes == 1:
        return Passes(of_passes[0], path)
    approach = path.conditions.approach
    lead_in = None if approach is None else _setup(_with_condition(settings, path.conditions, approach))
    return Passes(of_passes[0], path, setups, lead_in)


def _with_condition(settings: CutSettings, conditions: Conditions, name: str | None) -> CutSettings:
    """Return the settings of a cut with what the table says of a condition."""
    if name is None:
        return settings
    found = dict(conditions.settings[name])
    decided: dict[str, Any] = {}
    if "feed_um_s" in found:
        decided["controller"] = f"trim:feed_um_s={found.pop('feed_um_s'):g}"
    if "open_target_share" in found:
        decided["controller"] = f"counts:open_target_share={found.pop('open_target_share'):g}"
    if "tension_N" in found:
        decided["tension"] = found.pop("tension_N")
    for option, value in {**decided, **found}.items():
        usual = CutSettings.model_fields[option].default
        if getattr(settings, option) not in (usual, value):
            raise InputError(f"the table of conditions decides {option} of {name}: leave the option out")
    return settings.model_copy(update={**decided, **found})


def _setup(settings: CutSettings) -> PassSetup:
    controller = settings.controller
    return PassSetup(settings.load_machine(), from_text(controller) if isinstance(controller, str) else controller)


def in_force(settings: CutSettings, technology: Technology, table: PassTable) -> CutSettings:
    """Return settings with what the technology decides, that of its rough pass; refuse what contradicts it."""
    rough = table.settings[0]
    decided: dict[str, Any] = {
        "machine": technology.machine, "wire": technology.wire, "planner": technology.planner,
        "controller": rough.controller(), **{name: getattr(rough, own) for name, own in _OF_PASS.items()},
    }  # fmt: skip
    for name, value in decided.items():
        chosen, usual = getattr(settings, name), CutSettings.model_fields[name].default
        if chosen not in (usual, value):
            raise InputError(
                f"the technology '{technology.title}' sets {name} to {value!r}, not {chosen!r}: omit the option, "
                "or choose a technology with this value"
            )
    return settings.model_copy(update=decided)


def _technology(settings: CutSettings) -> Technology:
    if settings.technology is not None:
        found = read_technology(settings.technology)
        if found.material != settings.material:
            raise InputError(f"the technology '{found.title}' is for {found.material}, not for {settings.material}")
        return found
    usual = CutSettings.model_fields
    machine, wire = (
        None if getattr(settings, name) == usual[name].default else getattr(settings, name)
        for name in ("machine", "wire")
    )
    return nearest_technology(settings.material, machine, wire)


def _table(settings: CutSettings, technology: Technology, passes: int) -> PassTable:
    """Return the offsets and settings of a technology, with a notice if it is for another material."""
    height_mm, material = settings.workpiece.greatest_mm, settings.material
    table = technology.table(height_mm, passes)
    if technology.material == material:
        return table
    notice = (
        f"there is no technology for {material}: the passes take the settings of '{technology.title}', the material "
        f"most like it; search its own with edmsim tune technology {material} --height {height_mm:g} --passes "
        f"{passes} --out {material}.toml, and cut with --technology {material}.toml"
    )
    return table._replace(notices=(notice, *table.notices))


def _made(
    settings: CutSettings, technology: Technology, table: PassTable, path: CutPath, notices: tuple[str, ...]
) -> Passes:
    """Make the set-ups of the passes; the first is the machine of the settings."""
    setups = tuple(setup_of(settings, technology, one) for one in table.settings)
    approach = approach_of(setups[0].machine, table, table.settings[0])
    path = replace(path, notices=(*path.notices, *notices))
    return Passes(settings, path, setups, approach, table, technology)


def setup_of(settings: CutSettings, technology: Technology, one: PassSetting) -> PassSetup:
    """Return the set-up of a pass, with the constants of a cut's settings; raises `InputError` as `Machine.load`."""
    return PassSetup(_machine(settings, technology, one), from_text(one.controller()))


def approach_of(machine: Machine, table: PassTable, rough: PassSetting) -> PassSetup:
    """Return the set-up of a lead-in: the rough pass' machine, at a share of its feed."""
    return PassSetup(machine, from_text(rough.controller(table.approach_share)))


def _machines(settings: CutSettings, technology: Technology, table: PassTable) -> list[Machine]:
    """Return the machine as it is set up for each pass."""
    later = [_machine(settings, technology, one) for one in table.settings[1:]]
    return [settings.load_machine(), *later]


def _machine(settings: CutSettings, technology: Technology, one: PassSetting) -> Machine:
    height_mm = settings.workpiece.greatest_mm
    machine = machine_of(one, technology.machine, settings.material, technology.wire, height_mm)
    return with_overrides(machine, settings.overrides) if settings.overrides else machine
