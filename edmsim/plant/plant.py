"""Plant: the machine and its gap, advanced one window of 255 pulses at a time."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.compiled.random import key_of
from edmsim.errors import InputError, methods_refuse_wrong_types, one_of, refuse_unknown
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import finite, whole_from, whole_within
from edmsim.plant import constants
from edmsim.plant.axes.drives import AXIS_NAMES, FAULTS, AxisDrive, Drives, break_axis, reason, reason_of_delay
from edmsim.plant.axes.geometric_errors import geometric_errors_of
from edmsim.plant.gap.generator import OppositePulses, opposite_pulses
from edmsim.plant.gap.rays import Rays, pack_rays
from edmsim.plant.kernel import state as loop
from edmsim.plant.kernel.memory import CALL, Memory, window_function
from edmsim.plant.mechanics.full_model import FullMechanics
from edmsim.plant.mechanics.model import N_NODES, ModalModel
from edmsim.plant.resolution import RESOLUTIONS, Resolution
from edmsim.plant.resolution import resolution as named_resolution
from edmsim.plant.snapshot import check_snapshot, digest_of
from edmsim.plant.window import PlantError, left_validity, pass_window, read_window, without_wire, wrong_step
from edmsim.plant.workpiece.blanks import block_in_front, checked_stock
from edmsim.plant.workpiece.kerf_field import KerfField, Stock

MECHANICS = ("modal", "mujoco")  # integrators of table and wire
_OF_WIRE, _CHANGING = loop.lasting(loop.Arrays, loop.CHANGING), loop.lasting(loop.Arrays, loop.WALL, loop.CHANGING)
_OVERRUN_UM = 2000.0  # distance behind its end switches within which a table is stopped (ours)
_NOWHERE_UM, _NO_STEPS = -1e9, np.empty((0, 3), np.int64)


def _coordinates(resolution: Resolution, mechanics: str) -> int:
    """Return the number of coordinates of the wire in each plane: of its modes, or of MuJoCo's nodes."""
    return resolution.modes if mechanics == "modal" else N_NODES


def shapes() -> list[tuple[int, int, int, bool]]:
    """Return the arguments of `window_function` for every named resolution and integrator."""
    return [
        (res.slices, res.rays, _coordinates(res, mechanics), mechanics == "mujoco")
        for mechanics in MECHANICS for res in RESOLUTIONS.values()
    ]


@methods_refuse_wrong_types
class Plant:
    """A simulated wire-EDM machine: table, wire, generator and gap.

    Parameters
    ----------
    machine : Machine
        The set-up.
    seed : int
        The same seed, set-up and motion give the same result, bit for bit.
    stock : Stock, optional
        The workpiece; by default a block with a straight edge just in front of the wire (towards +x).
    position_um : sequence of float, optional
        Start position of the wire: x and y on the table, by default its middle, and u and v, by default 0.
    resolution : {"fast", "default", "fine"} or Resolution
    mechanics : {"modal", "mujoco"}
        Mechanics of table and wire: the exact propagation of their modes, or MuJoCo with the full model, with lost
        steps and friction.
    drives : mapping of str to drive, optional
        By axis, ``x y u v`` (see `edmsim.controllers.axis`); other axes have a stepper. The plant uses copies.

    Attributes
    ----------
    drives : dict of str to drive
        The plant's own drives by axis: you may write their parameters between windows.

    Examples
    --------
    >>> import edmsim
    >>> plant = edmsim.Plant(edmsim.Machine.load(), seed=1, resolution="fast")
    >>> window = plant.advance()
    >>> window.short + window.open + window.spark + window.arc
    255
    """

    def __init__(
        self,
        machine: Machine,
        seed: int = 0,
        *,
        stock: Stock | None = None,
        position_um: Sequence[float] | None = None,
        resolution: str | Resolution = "default",
        mechanics: str = "modal",
        drives: Mapping[str, AxisDrive] | None = None,
    ) -> None:
        if isinstance(machine, str):
            raise InputError(f"a plant takes a machine, not its name: edmsim.Machine.load({machine!r})")
        refuse_unknown("mechanics", mechanics, MECHANICS)
        self.mechanics = mechanics
        self.resolution = res = named_resolution(resolution)
        coordinates = _coordinates(res, mechanics)
        self._sizes = loop.sizes_of(res.slices, res.rays, coordinates)
        self._memory = Memory(self._sizes)
        self._state: NDArray[np.void] = np.zeros(1, loop.STATE)
        self._window: NDArray[np.void] = np.zeros(1, loop.WINDOW)
        self.move_rows(self._state, self._window)
        call = np.zeros(CALL, np.int64)
        self._call = memoryview(call)  # type: ignore[arg-type]
        self._call[0] = self._memory.address
        self._call_address: int = call.ctypes.data
        self._fire = window_function(res.slices, res.rays, coordinates, mechanics == "mujoco")
        self._arrays = loop.allocate(loop.Arrays, self._sizes)
        self._propagators = loop.allocate(loop.Propagators, self._sizes)
        for group in (self._arrays, self._propagators, loop.allocate(loop.Scratch, self._sizes)):
            self._memory.put(group)
        self._pulses: NDArray[np.void] = np.zeros(0, loop.PULSE)
        self._memory.put_own(pulses=self._pulses)
        self._drives_follow_from: tuple[bytes, float, float] | None = None
        self._set_up(machine, drives or {})
        self.reset(seed, stock=stock, position_um=position_um)

    def _set_up(self, machine: Machine, drives: Mapping[str, AxisDrive]) -> None:
        """Compute everything that depends on the machine; allocated memory stays."""
        self._set_up_drives(machine, drives)
        self._set_up_setting(machine)

    def _set_up_setting(self, machine: Machine) -> None:
        """Compute everything that depends on the machine except its drives."""
        self._first_machine = machine
        self._model = self._make_model()
        self._take_constants()
        for axis in (0, 1):
            if isinstance(self._model, FullMechanics) and self._drives.has_loop(axis):
                self._model.set_motor(axis, self._drives.axes.motors[axis : axis + 1])
        self._grid_us = 0.0  # the propagators belong to the previous model

    def _take_constants(self) -> None:
        """Compute everything that depends on the first machine except drives and mechanics."""
        machine, res = self._first_machine, self.resolution
        self._constants = constants.constants(machine, res)
        constants.fill_arrays(self._arrays, self._model, machine, res)
        for group in (self._constants, constants.heat_law(machine, res), constants.push_law(machine)):
            self._memory.put(group)
        self._settings = constants.settings_of(machine, res)

    def _set_up_drives(self, machine: Machine, drives: Mapping[str, AxisDrive]) -> None:
        errors = geometric_errors_of(machine, nuts=self.mechanics == "modal")
        travel_um = machine.base.table.travel_mm.value * 1e3
        follows_from = errors.tobytes(), travel_um, machine.wire_diameter_um
        if follows_from == self._drives_follow_from and not drives:
            return
        self._drives_follow_from = follows_from
        screws = constants.screws(machine) if drives else {}
        stray_um = 0.5 * machine.wire_diameter_um
        self._drives = Drives(drives, travel_um, self._sizes, screws, errors, stray_um)
        self._memory.put(self._drives.axes)
        self.drives = self._drives.by_axis

    def move_rows(self, state: NDArray[np.void], window: NDArray[np.void]) -> None:
        """Move the plant's scalars into rows (1,) of the arrays of `STATE` and `WINDOW` of a `Fleet`."""
        state[:], window[:] = self._state, self._window
        self._state, self._window = state, window
        self._window_bytes = memoryview(window.view(np.uint8))  # type: ignore[arg-type]
        self._memory.put_own(state=state, window=window)

    def _make_model(self) -> ModalModel | FullMechanics:
        """Return the model of table and wire; the plant holds it, because its loop has the model's addresses."""
        if self.mechanics == "modal":
            return constants.modal_model(self._first_machine, self.resolution)
        full = constants.full_mechanics(self._first_machine, self.resolution)
        self._memory.put(full.link)
        return full

    def _set(self, t_on_us: float, t_period_us: float, on: bool) -> None:
        self._setting = setting = self._settings(t_on_us, t_period_us, on)
        for group in setting[:3]:
            self._memory.put(group)
        if isinstance(self._model, ModalModel) and self._grid_us != setting.timing.grid_us:
            self._grid_us = setting.timing.grid_us
            constants.fill_propagators(self._propagators, self._model, setting.timing)

    def reset(
        self, seed: int, *, stock: Stock | None = None, position_um: Sequence[float] | None = None,
        machine: Machine | None = None,
    ) -> None:
        """Reset to rest: new workpiece and wire, the generator on, at the setting of the machine.

        That is the plant's first machine, or the one of the last `change_setup` or `drift`.

        Parameters
        ----------
        seed, stock, position_um
            See `Plant`.
        machine : Machine, optional
            Another set-up, as for a new plant, with new copies of the given drives.
        """
        key, new = key_of(whole_from("seed", seed, 0)), self._first_machine if machine is None else machine
        position_um = new.base.table.centre_um if position_um is None else self._checked_place(position_um, new)
        stock = block_in_front(new, position_um[0]) if stock is None else checked_stock(stock, new)
        if machine is not None:  # all arguments are valid; a refused call changes nothing
            self._set_up(machine, self._drives.options)
        self._set(new.t_on_us, new.t_period_us, on=True)
        res, travel_um = self.resolution, new.base.table.travel_mm.value * 1e3
        self.field = KerfField(res.slices, stock, res.cell_um, travel_um)
        self._put_field()
        self._state[:] = 0
        self._window[:] = 0
        self._state["key"] = key
        self._state["commanded_um"][0, : len(position_um)] = position_um
        self._state["axis_um"] = self._state["commanded_um"]
        self._drives.reset(self._state, seed)
        if isinstance(self._model, FullMechanics):
            self._model.reset()
        self._reset_arrays(_CHANGING)
        self._share_water()
        constants.set_vertical(self._arrays)

    def _checked_place(self, position_um: Sequence[float], machine: Machine) -> tuple[float, ...]:
        """Return a position as numbers; refuse one without two or four numbers, or far beyond the travel."""
        travel_um = machine.base.table.travel_mm.value * 1e3
        place = tuple(finite("position_um", um) for um in np.ravel(position_um).tolist())
        if len(place) not in (2, 4):
            raise InputError(f"position_um has {len(place)} numbers: give x and y, or x, y, u and v")
        if not all(-_OVERRUN_UM <= um <= travel_um + _OVERRUN_UM for um in place[:2]):
            x, y = place[:2]
            raise InputError(f"position_um, X {x:g} Y {y:g} um, is not on the table of 0 to {travel_um:g} um")
        return place

    def change_setup(self, machine: Machine) -> None:
        """Continue with another setting of the same machine, as for the next pass.

        Metal, clock, axes and the random generator stay. The pulse generator is on at the new setting; the wire is at
        rest under its new tension, in clean water.

        Parameters
        ----------
        machine : Machine
            It may differ in generator, pulses, tension, wire speed and nozzles.

        Raises
        ------
        InputError
            If machine, wire, material or height differ: they cannot change during a cut.
        """
        self._check_goes_on(machine)
        table_q = self._arrays.table_q.copy()
        lost = self._model.snapshot() if isinstance(self._model, FullMechanics) else {}
        self._set_up_setting(machine)
        self._set(machine.t_on_us, machine.t_period_us, on=True)
        self._share_water()
        constants.set_vertical(self._arrays)
        self._rest_wire()
        if isinstance(self._model, FullMechanics):
            self._arrays.table_q[:] = table_q
            self._model.restore(lost)

    def _check_goes_on(self, machine: Machine, *more: str) -> None:
        """Refuse a set-up that differs in a property that cannot change during a cut."""
        for name in ("base", "wire", "wire_diameter_um", "material", "height_mm", *more):
            if getattr(machine, name) != getattr(self._first_machine, name):
                raise InputError(f"a set-up with another {name} cannot go on with this cut: begin another one")

    def drift(self, machine: Machine) -> None:
        """Change the water during a cut; everything else continues unchanged.

        Parameters
        ----------
        machine : Machine
            The plant's, with another dielectric and other nozzle pressures; the present pulse setting stays.

        Raises
        ------
        InputError
            If it differs in wire, material, height, tension, or anything else of the machine.
        """
        now, water = self.machine, {"dielectric": self._first_machine.base.dielectric}
        same_water = machine.model_copy(update={"base": machine.base.model_copy(update=water)})
        self._check_goes_on(same_water, "tension")
        machine.with_pulses(now.t_on_us, now.t_period_us)  # refuse before anything is changed
        self._first_machine = machine
        self._take_constants()
        self._share_water()
        self._set(now.t_on_us, now.t_period_us, self._setting.on)

    def _share_water(self) -> None:
        """Let the jets' water enter every slice by its share of the flow, and by the height of its metal."""
        self._arrays.entering[:] = self._arrays.flow_share / self._arrays.metal[: self.resolution.slices]

    def _rest_wire(self) -> None:
        """Reset the wire and the water around it to rest; metal and axes do not change."""
        for name in ("heat_wait_us", "spot", "wear_wait_um3", "worn_share", "broken", "traces"):
            self._state[name] = 0
        self._reset_arrays(_OF_WIRE)

    def _reset_arrays(self, names: Sequence[str]) -> None:
        """Set arrays to their values at rest."""
        constants.reset_arrays(self._arrays, names, self._constants.water_K)
        self._state["since_discharge_us"] = 1e9
        self._state["tiled_um"] = _NOWHERE_UM
        self._state["deflection_um"] = 0.0

    def set_generator(self, t_on_us: float, t_period_us: float) -> None:
        """Change the pulse setting from the next window on; raises `InputError` if the generator refuses it."""
        self._set(t_on_us, t_period_us, self._setting.on)

    def switch_generator(self, on: bool) -> None:
        """Run or stop the generator from the next window on.

        With the generator stopped, windows keep their length and table and wire move, without voltage or current. A
        window then counts opens, and shorts where the wire touches.
        """
        self._set(self.machine.t_on_us, self.machine.t_period_us, bool(on))

    def rethread(self, position_um: Sequence[float], duration_ns: int) -> float:
        """Cut the wire, move to another place with the generator off, and thread a new wire there.

        Parameters
        ----------
        position_um : sequence of float
            Of x and y, and of u and v, if they move as well. A servo axis moves to the nearest
            whole step, at the table's rapid speed.
        duration_ns : int
            For moving and threading. It is extended until such an axis is in place.

        Returns
        -------
        float
            Time (s) of axes that are too slow to wait for; 0 if there are none.

        Raises
        ------
        InputError
            If the place is not on the table, or the duration is negative or not a whole number.
        """
        position_um = self._checked_place(position_um, self.machine)
        duration_ns = whole_from("duration_ns", duration_ns, 0)
        table_q, table = self._arrays.table_q.copy(), self.machine.base.table
        step_um, rapid_um_s = table.step_um.value, table.rapid_um_s.value
        took_ns, late_s = self._drives.carry(self._state, position_um, duration_ns, step_um, rapid_um_s)
        self._state["time_ns"] += took_ns
        self._rest_wire()
        if self.mechanics == "mujoco":
            self._arrays.table_q[:] = table_q  # lost steps stay lost
        return late_s

    def take_metal(self, metal: KerfField) -> None:
        """Continue with a copy of the remaining metal of another cut, with as many slices and as large cells.

        Raises
        ------
        InputError
            If slices or cells differ.
        """
        own = self.field
        if (metal.n_slices, metal.cell_um, metal.index.shape) != (own.n_slices, own.cell_um, own.index.shape):
            raise InputError("the metal of the earlier cut has other slices or cells: take the same resolution")
        travel_um = self.machine.base.table.travel_mm.value * 1e3
        self.field = KerfField(metal.n_slices, metal.stock, metal.cell_um, travel_um)
        self.field.restore(metal.snapshot())
        self._put_field()
        self._state["tiled_um"] = _NOWHERE_UM
        self._state["traces"] = 0

    def remove_piece(self, piece: shapely.Polygon) -> float:
        """Remove a loose piece of metal from the workpiece, in every slice; return its volume in mm3.

        Parameters
        ----------
        piece : shapely.Polygon
            In um on the table, without holes.
        """
        taken_um2 = self.field.remove_piece(piece)
        self._put_field()
        self._state["traces"] = 0
        return taken_um2 * self._constants.slice_um * 1e-9

    def break_axis(self, axis: str, fault: str) -> None:
        """Give a servo axis a fault of `edmsim.plant.axes.drives.FAULTS`."""
        if axis not in self.own_step_um:
            raise InputError(f"there is no servo axis {axis!r}")
        if fault not in FAULTS:
            raise InputError(f"there is no fault {fault!r}; there are: {one_of(fault, FAULTS)}")
        break_axis(self._drives.axes, AXIS_NAMES.index(axis), fault)

    def watch_pulses(self) -> None:
        """Record every pulse from the next window on (`last_pulses`); the cut stays the same, bit for bit."""
        self._pulses = np.zeros(WINDOW_PULSES, loop.PULSE)
        self._memory.put_own(pulses=self._pulses)

    def advance(
        self, steps: Sequence[tuple[int, int, int]] | NDArray[np.int64] = (), pulses: int = WINDOW_PULSES
    ) -> PulseWindow:
        """Fire 255 pulses, or fewer.

        Parameters
        ----------
        steps : sequence of (time_ns, axis, direction)
            Motor steps of the window in order of time: machine time in ns, 0 for x, 1 for y, 2 for u, 3 for v,
            +1 or -1. For a servo drive a step is an edge at its input; then 4, 5 and 6 are the drives' input
            lines stop, fault and enable, and the last number is the line's level, 0 or 1. Steps at or after the
            window's end are not made: pass those again that are still to be made.
        pulses : int
            1 to 255. Craters are carved at a window's end: the same pulses in shorter windows give other results.

        Returns
        -------
        PulseWindow

        Raises
        ------
        InputError
            If a step has another axis or direction or is in the past or out of order, or if `pulses` is out of range.
        PlantError
            If the wire broke in an earlier window (`WireBrokenError`), or the model left its valid range
            (`WireLostError`, `WireInMetalError`, `NotFiniteError`).
        """
        if type(pulses) is not int or not 1 <= pulses <= WINDOW_PULSES:
            pulses = whole_within("pulses", pulses, 1, WINDOW_PULSES)
        return self._advance(steps, pulses)

    def _advance(self, steps: Sequence[tuple[int, int, int]] | NDArray[np.int64], pulses: int) -> PulseWindow:
        rows, place = _NO_STEPS, 0
        if len(steps):
            rows = np.array(steps, order="C")
            if rows.dtype != np.int64 and rows.dtype.kind in "iu":
                rows = rows.astype(np.int64)
            if rows.ndim != 2 or rows.shape[1] != 3 or rows.dtype != np.int64:
                raise InputError("steps are rows of time_ns, axis and direction, in whole numbers, not an array of "
                                 f"shape {rows.shape} and type {rows.dtype}")
            place = ctypes.addressof(ctypes.c_char.from_buffer(rows.data))  # numpy takes 1 % of a window for it
        status = self._fire_once(place, len(rows), pulses)
        if status == loop.FINE:  # the usual case
            return read_window(self._window_bytes)
        if status == loop.BROKEN and self._has_no_wire:
            pass_window(
                self._state, self._window, self._drives, self._setting.timing, rows, self._constants.step_um, pulses
            )
            passed = self.window()
            if len(self._pulses):
                self._pulses[:pulses] = without_wire(passed, self.timing)
            return passed
        if status == loop.NO_TILES:
            self.make_tiles()
            status = self._fire_once(place, len(rows), pulses)
        if status in (loop.STEP_WRONG, loop.STEP_EARLY):
            raise InputError(wrong_step(rows, self.time_ns, self._drives.axes.loops > 0))
        window = self.window()
        if status != loop.FINE:
            raise self.left_validity(status, window)
        return window

    def continue_without_wire(self) -> None:
        """Continue without a wire after a break that its sensor missed.

        Until `rethread` or `reset`, all pulses of a window are open, and the axes move as in a rapid.
        """
        self._state["broken"] = loop.BARE

    def advance_pulse(self, steps: Sequence[tuple[int, int, int]] | NDArray[np.int64] = ()) -> PulseWindow:
        """Fire one pulse, for studies of single pulses; breaks of the wire are not checked.

        Every pulse is a window with its crater carved at the end. This is slower, and the results differ from those
        of the same pulses in windows of 255.

        Parameters
        ----------
        steps : sequence of (time_ns, axis, direction)
            Motor steps of the pulse's period, as for `advance`.

        Returns
        -------
        PulseWindow
            Of the one pulse; its deflection is that of the wire at the start of the pulse.

        Raises
        ------
        InputError, PlantError
            As `advance`.
        """
        try:
            return self._advance(steps, 1)._replace(broken=False)
        finally:
            self._state["broken"] = np.where(self._state["broken"] == loop.BARE, loop.BARE, 0)

    def _fire_once(self, steps: int, count: int, pulses: int) -> int:
        self._call[1], self._call[2], self._call[3] = steps, count, pulses
        self._fire(self._call_address, 1)
        return self._call[4]

    @property
    def address(self) -> int:
        """Address of the plant's table for the compiled loop (see `memory.CALL`)."""
        return self._memory.address

    @property
    def fire(self) -> Callable[[int, int], None]:
        """The compiled window of the plant's resolution (see `memory.window_function`)."""
        return self._fire

    def make_tiles(self) -> None:
        """Allocate the kerf field's tiles around the wire; the loop reports when they are missing."""
        s, c = self._state[0], self._constants
        x, y = (float(v) for v in s["axis_um"][:2] + s["deflection_um"])
        u, v = (float(v) for v in s["axis_um"][2:])
        n = self.resolution.slices
        shares = self._arrays.height_share, self._arrays.lean_share
        ends = [float(share[k]) for share in shares for k in (0, n - 1)]
        low, high = min(ends), max(ends)  # the places where the wire bends are known after its rays were traced
        reach_um = c.radius_um + c.range_um + 2 * loop.TILED_UM + self._drives.reach_um
        tiles = self.field.tiles
        self.field.allocate(x + low * u, y + low * v, reach_um, ((high - low) * u, (high - low) * v))
        if self.field.tiles is not tiles:  # the array was too small, and `levels` with it
            self._put_field()
        self._state["tiled_um"] = (x, y, x + u, y + v)

    def _put_field(self) -> None:
        self._memory.put_own(tiles=self.field.tiles, tile_index=self.field.index, levels=self.field.levels)

    def window(self) -> PulseWindow:
        """Return the last window.

        Raises
        ------
        InputError
            If no window was fired since the plant was made or reset.
        """
        return read_window(self._window_bytes)

    def left_validity(self, status: int, window: PulseWindow) -> PlantError:
        """Return the error for a window that left the model's range."""
        return left_validity(status, window, self.time_ns * 1e-9, self.commanded_um)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state as arrays; `restore` continues bit for bit."""
        drives = {axis: drive.name for axis, drive in self.drives.items()}
        state: dict[str, NDArray[Any]] = {"set_up": digest_of(self._first_machine, drives)}
        state.update({f"field.{k}": v for k, v in self.field.snapshot().items()})
        state.update({name: getattr(self._arrays, name).copy() for name in _CHANGING})
        state.update(self._drives.snapshot())
        if isinstance(self._model, FullMechanics):
            state.update(self._model.snapshot())
        state["state"] = self._state.copy()
        state["setting"] = np.array([self.machine.t_on_us, self.machine.t_period_us, self._setting.on], np.float64)
        return state

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Load a `snapshot` of a plant with the same set-up and resolution; others raise `InputError`."""
        check_snapshot(state, self.snapshot(), self._sizes)
        self._take(state)

    def with_machine(self, machine: Machine) -> Plant:
        """Return a plant with another set-up of the same machine that continues where this one is.

        Other than after `change_setup`, nothing comes to rest. Raises `InputError` if machine, wire, material or
        height differ.
        """
        self._check_goes_on(machine)
        plant = Plant(
            machine, stock=self.field.stock, resolution=self.resolution, mechanics=self.mechanics,
            drives=self._drives.options,
        )
        plant._take(self.snapshot())
        plant._share_water()
        return plant

    def _take(self, state: dict[str, NDArray[Any]]) -> None:
        self._drives.check(state, int(state["state"]["time_ns"][0]))
        t_on, t_period, on = (float(v) for v in state["setting"])
        if bool(on) != self._setting.on:
            self.switch_generator(bool(on))
        if (t_on, t_period) != (self.machine.t_on_us, self.machine.t_period_us):
            self.set_generator(t_on, t_period)
        self.field.restore({k.removeprefix("field."): v for k, v in state.items() if k.startswith("field.")})
        self._put_field()
        for name in _CHANGING:
            getattr(self._arrays, name)[:] = state[name]
        self._drives.restore(state)
        if isinstance(self._model, FullMechanics):
            self._model.restore(state)
        self._state[:] = state["state"]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a pickle or copy: the set-up and a snapshot, without addresses."""
        return {
            "machine": self._first_machine, "mechanics": self.mechanics, "resolution": self.resolution,
            "stock": self.field.stock, "window": self._window.copy(), "snapshot": self.snapshot(),
            "pulses": self._pulses, "drives": self._drives.options,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Build the plant again and continue where the snapshot was taken."""
        options = {name: state[name] for name in ("stock", "resolution", "mechanics", "drives")}
        Plant.__init__(self, state["machine"], **options)
        self.restore(state["snapshot"])
        self._window[:] = state["window"]
        self._pulses = state["pulses"].copy()
        self._memory.put_own(pulses=self._pulses)

    def __repr__(self) -> str:
        """Return the set-up with position and time as text."""
        res, (x, y) = self.resolution, self.commanded_um
        generator = "on" if self.generator_on else "off"
        return (
            f"<Plant of {self.machine!r}\n"
            f"  {self.mechanics}, {res.slices} slices x {res.rays} rays x {res.modes} modes\n"
            f"  at X {x / 1e3:.3f} Y {y / 1e3:.3f} mm on the table after {self.time_ns * 1e-9:.3f} s and "
            f"{self.pulses} pulses, generator {generator}>"
        )

    @property
    def time_ns(self) -> int:
        """Machine time in ns."""
        return int(self._state["time_ns"][0])

    @property
    def pulses(self) -> int:
        """Pulses fired so far."""
        return int(self._state["pulses"][0])

    @property
    def commanded_um(self) -> tuple[float, float]:
        """Setpoint of x and y: the position that the motor steps add up to."""
        x, y = self._state["commanded_um"][0, :2]
        return float(x), float(y)

    @property
    def lead_um(self) -> tuple[float, float]:
        """Setpoint of u and v: the lead of the upper guide over the lower one."""
        u, v = self._state["commanded_um"][0, 2:]
        return float(u), float(v)

    @property
    def axes_um(self) -> tuple[float, float, float, float]:
        """Positions of the axes x, y, u, v, without the ringing of the table after motor steps."""
        x, y, u, v = self._state["axis_um"][0]
        return float(x), float(y), float(u), float(v)

    @property
    def place_um(self) -> tuple[float, float]:
        """True position of x and y; the position counter shows neither ringing nor lost steps (row T-19)."""
        x, y = self._state["axis_um"][0, :2] + (self._arrays.table_shape * self._arrays.table_q).sum(axis=1)
        return float(x), float(y)

    @property
    def machine(self) -> Machine:
        """The set-up, with the pulse setting in force."""
        return self._setting.machine

    @property
    def generator_on(self) -> bool:
        """Whether the generator runs; initially it does."""
        return self._setting.on

    @property
    def following_error_um(self) -> tuple[float, float]:
        """Commanded position of x and y less their actual one; 0 under a stepper, which is not monitored."""
        return self.following_error_in_um(self._state[0])

    def following_error_in_um(self, state: np.void) -> tuple[float, float]:
        """Return the following error in a record of `STATE` of this plant, the present or an earlier one."""
        x, y = state["commanded_um"][:2] - state["indicated_um" if self._drives.axes.errs else "axis_um"][:2]
        return float(x), float(y)

    @property
    def drive_faults(self) -> int:
        """Axes that have to stop: bit 0 for x, 1 for y, 2 for u, 3 for v.

        An axis has to stop if its drive reports a fault or commands an invalid share of its supply, or if it is
        further from the position of its steps than the wire's radius.
        """
        return self._drives.faults()

    @property
    def fault_reason(self) -> str:
        """Reason why the axes of `drive_faults` have to stop; empty if there are none."""
        return reason(self._drives)

    @property
    def away_um(self) -> NDArray[np.float64]:
        """Distance of x, y, u and v from the position of their steps; 0 under a stepper, which is not monitored."""
        return self._drives.away_um(self._state)

    def reason_of_delay(self, late_s: float) -> str:
        """Return which axes are not in place, if any, and why; `late_s` is the time that they would need."""
        return "" if self.in_place else reason_of_delay(self._drives, self.away_um, self._constants.step_um, late_s)

    @property
    def in_place(self) -> bool:
        """Whether all servo axes are within a step of the position of their steps."""
        return bool(np.all(self.away_um <= self._constants.step_um))

    @property
    def is_moving_fast(self) -> bool:
        """Whether a servo axis moves too fast to be settling: it oscillates, or runs away."""
        return self._drives.is_moving_fast(self._constants.step_um)

    @property
    def own_step_um(self) -> dict[str, float]:
        """Travel per step edge of every servo axis."""
        return {name: self._drives.step_um(k) for k, name in enumerate(AXIS_NAMES) if self._drives.has_loop(k)}

    @property
    def window_ns(self) -> int:
        """Duration of a window at the present setting; 0 where the period varies (row T-42)."""
        return WINDOW_PULSES * self._setting.timing.period_ns

    @property
    def longest_window_ns(self) -> int:
        """Upper bound of a window's duration at the present setting."""
        return self.window_ns or WINDOW_PULSES * math.ceil(self._setting.timing.grid_us * loop.GRID * 1e3)

    @property
    def removed_mm3(self) -> float:
        """Metal removed so far, including craters that are not carved into the kerf field yet."""
        return float(self.field.removed_um2 + self._arrays.pending_um2.sum()) * self._constants.slice_um * 1e-9

    @property
    def craters_mm3(self) -> float:
        """Metal the discharges removed so far, added up crater by crater."""
        s = self._state[0]
        pending_um3 = float(self._arrays.carry_um2.sum()) * self._constants.slice_um
        return float(s["crater_um3"] - s["missed_um3"] - pending_um3) * 1e-9

    @property
    def broken_height_mm(self) -> float:
        """Height above the workpiece's lower face at which the wire broke; NaN with a whole wire or none."""
        if self._state["broken"][0] != 1:
            return math.nan
        middle = float(self._state["broken_slice"][0]) + 0.5
        return middle * self._constants.slice_um * 1e-3

    def deflections_um(self) -> NDArray[np.float64]:
        """Deflection of the wire now, (slices, 2): x and y from the line between the guides."""
        return self._arrays.shape @ self._arrays.wire_q.T

    def coverage(self) -> NDArray[np.float64]:
        """Share of the wire's front that gas covers now, (slices,) from the lowest: 0 to 1; 0 without a wire."""
        if self._has_no_wire:
            return np.zeros(self.resolution.slices)
        return self._arrays.covered[: len(self._arrays.shape)].copy()

    def rays(self) -> Rays:
        """Rays of every slice, as traced last, with the craters since then."""
        rays = Rays(*(getattr(self._arrays, name).copy() for name in Rays._fields))
        pack_rays(rays)
        return rays

    @property
    def _has_no_wire(self) -> bool:
        """Whether the machine goes on without a wire."""
        return bool(self._state["broken"][0] == loop.BARE)

    @property
    def timing(self) -> loop.Timing:
        """Voltages, currents and times of the generator's present setting."""
        return self._setting.timing

    def leakage_S(self) -> float:
        """Return the conductance of the water between wire and metal; 0 without a wire."""
        if self._has_no_wire:
            return 0.0
        slices, rays = self._arrays.edge_um.shape
        reach_um = np.maximum(self._arrays.distance[:, :rays], 1.0).astype(np.float64)
        return float((self._arrays.metal[:slices, None] / reach_um).sum()) * self._constants.leak_S_um

    def opposite_pulses(self) -> OppositePulses | None:
        """Return the equalising pulses of the last window, fired at the present setting; None without a supply."""
        circuit = self.machine.generator.equalising if self.generator_on else None
        if circuit is None:
            return None
        return opposite_pulses(read_window(self._window_bytes), self.timing, circuit, self.leakage_S())

    def last_pulses(self) -> NDArray[np.void]:
        """Return the pulses of the last window as rows of `state.PULSE`, (n,); none if they are not watched."""
        fired = sum(self._window["counts"][0].tolist()) if len(self._pulses) else 0
        # as bytes, because numpy copies records field by field, which is 20 times slower
        return self._pulses.view(np.uint8)[: fired * loop.PULSE.itemsize].copy().view(loop.PULSE)

    def walls_um(self, slice_index: int) -> tuple[tuple[float, float], NDArray[np.float32]]:
        """Return the place of a slice's wire when its rays were last traced, and every ray's gap then (rays,).

        Ray ``k`` looks along the angle ``2 pi k / rays``; one that met no metal within reach has a gap beyond 1e6.
        """
        whole_within("slice_index", slice_index, 0, self.resolution.slices - 1)
        x, y = self._arrays.reference_um[:, slice_index]
        return (float(x), float(y)), self._arrays.edge_um[slice_index].copy()
