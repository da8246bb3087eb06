"""Plant: the machine and its gap, advanced one window of 255 pulses at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.random import key_of
from edmsim.errors import InputError
from edmsim.plant import constants
from edmsim.plant.gap.generator import switched_off, timing
from edmsim.plant.gap.rays import Rays
from edmsim.plant.kernel.memory import CALL, Memory, window_function
from edmsim.plant.kernel.state import (
    CHANGING,
    FINE,
    GRID,
    NO_TILES,
    PULSE,
    PULSES_PER_WINDOW,
    STATE,
    STEP_EARLY,
    STEP_WRONG,
    TILED_UM,
    WALL,
    WINDOW,
    Timing,
)
from edmsim.plant.mechanics.model import ModalModel
from edmsim.plant.mechanics.mujoco_model import FullMechanics
from edmsim.plant.window import PlantError, PulseWindow, left_validity, read_window, wrong_step
from edmsim.plant.workpiece.kerf_field import KerfField, Stock

if TYPE_CHECKING:
    from edmsim.machine.machine import Machine

MECHANICS = ("modal", "mujoco")
"""Integrators of table and wire."""
_NOWHERE_UM = -1e9
_FRONT_GAP_UM = 30.0
"""Gap in front of a plant that was given no workpiece."""


class Plant:
    """A wire-EDM machine at work.

    Parameters
    ----------
    machine : Machine
        The set-up.
    seed : int
        Same seed, same set-up, same motion: same bits.
    stock : Stock, optional
        The workpiece; without one, a block with a straight edge just in front of the wire (towards +x).
    position_um : (float, float)
        Where the wire starts on the table.
    resolution : {"fast", "default", "fine"}
    mechanics : {"modal", "mujoco"}
        What moves table and wire: the exact propagation of their modes, or MuJoCo stepping the full model, whose
        motors can lose steps and whose ways rub.

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
        position_um: tuple[float, float] = (32_500.0, 32_500.0),
        resolution: str = "default",
        mechanics: str = "modal",
    ) -> None:
        if mechanics not in MECHANICS:
            raise InputError(f"unknown mechanics '{mechanics}'; there are: {', '.join(MECHANICS)}")
        self.machine = machine
        self.mechanics = mechanics
        self._resolution_name = resolution
        self.resolution = res = constants.resolution(resolution)
        self._constants = constants.constants(machine, res)
        self._flow_factor = constants.flow_factor(machine, res)
        self._memory = Memory()
        self._state: NDArray[np.void] = np.zeros(1, STATE)
        self._window: NDArray[np.void] = np.zeros(1, WINDOW)
        self.lodge(self._state, self._window)
        call = np.zeros(CALL, np.int64)
        self._call = memoryview(call)  # type: ignore[arg-type]
        self._call[0] = self._memory.address
        self._call_address: int = call.ctypes.data
        self._model = self._make_model()
        coordinates = self._model.wire_shape.shape[1]
        self._fire = window_function(res.slices, res.rays, coordinates, mechanics == "mujoco")
        self._memory.keep_record("constants", self._constants)
        self._memory.keep_record("heat", constants.heat_law(machine, res))
        self._memory.keep_tuple(constants.scratch(res, coordinates))
        self._generator_on = True
        self._pulses: NDArray[np.void] = np.zeros(0, PULSE)
        self._memory.keep_pulses(self._pulses)
        self._set_timing(machine)
        self.reset(seed, stock=stock, position_um=position_um)

    def lodge(self, state: NDArray[np.void], window: NDArray[np.void]) -> None:
        """Move the plant's scalars into a row each of arrays (1,) of `STATE` and `WINDOW` that a `Fleet` holds."""
        state[:], window[:] = self._state, self._window
        self._state, self._window = state, window
        self._window_bytes = memoryview(window.view(np.uint8))  # type: ignore[arg-type]
        self._memory.keep(state=state, window=window)

    def _make_model(self) -> ModalModel | FullMechanics:
        """Return the model of table and wire; it stays alive with the plant, whose loop has its addresses."""
        if self.mechanics == "modal":
            return constants.modal_model(self.machine, self.resolution)
        full = constants.full_mechanics(self.machine, self.resolution)
        self._memory.keep_link(full.link)
        return full

    def _set_timing(self, machine: Machine) -> None:
        self._timing = timing(machine) if self._generator_on else switched_off(timing(machine))
        self._memory.keep_record("timing", self._timing)
        self._memory.keep_record("law", constants.gap_law(machine, self.resolution, self._timing.open_V))
        if isinstance(self._model, ModalModel):
            self._memory.keep_tuple(constants.propagators(self._model, self._timing))

    def reset(
        self, seed: int, *, stock: Stock | None = None, position_um: tuple[float, float] = (32_500.0, 32_500.0)
    ) -> None:
        """Start anew at rest, with a fresh workpiece and a fresh wire."""
        if stock is None:
            edge = position_um[0] + self._constants.radius_um + _FRONT_GAP_UM
            travel = self.machine.base.table.travel_mm.value * 1e3
            stock = Stock((edge, 0.0, travel, travel))
        if stock.steps and stock.height_mm != self.machine.height_mm:
            raise InputError(
                f"the stepped workpiece is {stock.height_mm:g} mm high and the machine set up for "
                f"{self.machine.height_mm:g} mm; they must be the same"
            )
        self.field = KerfField(
            self.resolution.slices, stock, self.resolution.cell_um,
            self.machine.base.table.travel_mm.value * 1e3,
        )
        self._memory.keep_field(self.field.tiles, self.field.index)
        self._state[:] = 0
        self._state["key"] = key_of(seed)
        self._state["commanded_um"] = position_um
        if isinstance(self._model, FullMechanics):
            self._model.reset()
        self._at_rest()

    def _at_rest(self) -> None:
        model = self._model
        self._arrays = constants.arrays(
            model.wire_shape, model.table_slide_shape, model.table_participation, self.resolution,
            self._constants.water_K, self._flow_factor,
        )
        self._memory.keep_tuple(self._arrays)
        self._state["since_discharge_us"] = 1e9
        self._state["tiled_um"] = _NOWHERE_UM
        self._state["deflection_um"] = 0.0

    def set_generator(self, t_on_us: float, t_period_us: float) -> None:
        """Change the pulse setting from the next window on; raises `InputError` if the generator refuses it."""
        self.machine = self.machine.with_(t_on_us=t_on_us, t_period_us=t_period_us)
        self._set_timing(self.machine)

    @property
    def generator_on(self) -> bool:
        """Whether the generator runs; a fresh plant's does."""
        return self._generator_on

    def switch_generator(self, on: bool) -> None:
        """Run or stop the generator from the next window on.

        Stopped, windows keep their length and table and wire move, but there is neither voltage nor current: what a
        window then counts are moments without a pulse, shorts where the wire touches.
        """
        self._generator_on = on
        self._set_timing(self.machine)

    def rethread(self, position_um: tuple[float, float], duration_ns: int) -> None:
        """Cut the wire, move to another place with the generator off, and thread a fresh wire there."""
        before = self._arrays
        self._state["commanded_um"] = position_um
        self._state["time_ns"] += duration_ns
        for name in ("heat_wait_us", "current2_us", "wear_wait_um3", "worn_share", "broken", "traces"):
            self._state[name] = 0
        self._at_rest()
        for name in WALL:
            getattr(self._arrays, name)[:] = getattr(before, name)
        if self.mechanics == "mujoco":
            self._arrays.table_q[:] = before.table_q  # steps once lost stay lost

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
        """Position the motor steps add up to."""
        x, y = self._state["commanded_um"][0]
        return float(x), float(y)

    @property
    def place_um(self) -> tuple[float, float]:
        """Where the axes really are: the position counter knows neither of ringing nor of lost steps (row T-19)."""
        x, y = self._state["commanded_um"][0] + (self._arrays.table_shape * self._arrays.table_q).sum(axis=1)
        return float(x), float(y)

    @property
    def window_ns(self) -> int:
        """Duration of a window at the present setting; 0 where the period varies (row T-42)."""
        return PULSES_PER_WINDOW * self._timing.period_ns

    @property
    def longest_window_ns(self) -> int:
        """Upper bound of a window's duration at the present setting."""
        return self.window_ns or PULSES_PER_WINDOW * math.ceil(self._timing.grid_us * GRID * 1e3)

    @property
    def removed_mm3(self) -> float:
        """Metal removed so far: what is carved from the kerf field, and what waits for it on the rays."""
        carved_um2 = self.field.removed_parts * self.field.part_area_um2
        return float(carved_um2 + self._arrays.pending_um2.sum()) * self._constants.slice_um * 1e-9

    @property
    def craters_mm3(self) -> float:
        """Metal the discharges removed so far, added up crater by crater."""
        s = self._state[0]
        kept = float(self._arrays.carry_um2.sum()) * self._constants.slice_um
        return float(s["crater_um3"] - s["missed_um3"] - kept) * 1e-9

    @property
    def broken_height_mm(self) -> float:
        """Height above the workpiece's lower face at which the wire broke."""
        middle = float(self._state["broken_slice"][0]) + 0.5
        return middle * self._constants.slice_um * 1e-3

    def deflections_um(self) -> NDArray[np.float64]:
        """Deflection of the wire now, (slices, 2): x and y from the line between the guides."""
        return self._arrays.shape @ self._arrays.wire_q.T

    def rays(self) -> Rays:
        """Every slice's rays as the loop sees them: as they were traced, less what craters took since."""
        return Rays(*(getattr(self._arrays, name).copy() for name in Rays._fields))

    @property
    def timing(self) -> Timing:
        """The generator's present setting as the loop has it: voltages, currents, times."""
        return self._timing

    def watch_pulses(self) -> None:
        """From the next window on, keep what every pulse was (`last_pulses`); the cut stays the same to the bit."""
        self._pulses = np.zeros(PULSES_PER_WINDOW, PULSE)
        self._memory.keep_pulses(self._pulses)

    def last_pulses(self) -> NDArray[np.void]:
        """Return the pulses of the last window as rows of `state.PULSE`, (n,); none if they are not watched."""
        fired = sum(self._window["counts"][0].tolist()) if len(self._pulses) else 0
        # as bytes: numpy copies records field by field, which takes twenty times as long
        return self._pulses.view(np.uint8)[: fired * PULSE.itemsize].copy().view(PULSE)

    def walls_um(self, slice_index: int) -> tuple[tuple[float, float], NDArray[np.float32]]:
        """Return where a slice's wire was when its rays were last traced, and every ray's gap then (rays,).

        Ray ``k`` looks along the angle ``2 pi k / rays``; one that met no metal within reach has a gap beyond 1e6.
        """
        x, y = self._arrays.reference_um[:, slice_index]
        return (float(x), float(y)), self._arrays.edge_um[slice_index].copy()

    def advance(self, steps: Sequence[tuple[int, int, int]] = ()) -> PulseWindow:
        """Fire 255 pulses.

        Parameters
        ----------
        steps : sequence of (time_ns, axis, direction)
            Motor steps of the window in order of time: machine time in ns, 0 for x or 1 for y, +1 or -1.

        Returns
        -------
        PulseWindow

        Raises
        ------
        InputError
            If a step has another axis or direction, or lies in the past or out of order.
        PlantError
            If the model left the range it holds for: `WireLostError`, `WireInMetalError`, `NotFiniteError`.
        """
        rows, place = _NO_STEPS, 0
        if len(steps):
            rows = np.array(steps, np.int64)
            if rows.ndim != 2 or rows.shape[1] != 3:
                raise InputError(f"steps are rows of time_ns, axis and direction, not an array of shape {rows.shape}")
            place = rows.__array_interface__["data"][0]
        status = self._fire_once(place, len(rows))
        if status == NO_TILES:
            self.make_tiles()
            status = self._fire_once(place, len(rows))
        if status in (STEP_WRONG, STEP_EARLY):
            raise InputError(wrong_step(rows, self.time_ns))
        window = self.window()
        if status != FINE:
            raise self.left_validity(status, window)
        return window

    def advance_pulse(self, steps: Sequence[tuple[int, int, int]] = ()) -> PulseWindow:
        """Fire one pulse, to look at pulses one by one; whether the wire breaks is not looked at.

        The window's end comes after every pulse then, and its crater is carved each time. That is slower, and
        differs in bits from the same pulses in windows of 255.

        Parameters
        ----------
        steps : sequence of (time_ns, axis, direction)
            Motor steps of the pulse's period, as `advance` takes them.

        Returns
        -------
        PulseWindow
            Of the one pulse; its deflection is the wire's when the pulse began.

        Raises
        ------
        InputError, PlantError
            As `advance`.
        """
        self._state["broken"] = 1  # the loop leaves a window after a pulse whose wire is broken
        try:
            return self.advance(steps)._replace(broken=False)
        finally:
            self._state["broken"] = 0

    def _fire_once(self, steps: int, count: int) -> int:
        self._call[1], self._call[2] = steps, count
        self._fire(self._call_address, 1)
        return self._call[3]

    @property
    def address(self) -> int:
        """Where the compiled loop finds the plant (see `memory.CALL`)."""
        return self._memory.address

    @property
    def fire(self) -> Callable[[int, int], None]:
        """The compiled window of the plant's resolution (see `memory.window_function`)."""
        return self._fire

    def make_tiles(self) -> None:
        """Make the kerf field's tiles around the wire, which the loop asks for when it lacks them."""
        s = self._state[0]
        x, y = (float(v) for v in s["commanded_um"] + s["deflection_um"])
        self.field.allocate(x, y, self._constants.radius_um + self._constants.range_um + 2 * TILED_UM)
        self._memory.keep_field(self.field.tiles, self.field.index)
        self._state["tiled_um"] = (x, y)

    def window(self) -> PulseWindow:
        """Return what happened in the last window."""
        return read_window(self._window_bytes)

    def left_validity(self, status: int, window: PulseWindow) -> PlantError:
        """Return the error that tells how a window left the model's range."""
        return left_validity(status, window, self.time_ns * 1e-9, self.commanded_um)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that changes, as arrays; `restore` continues bit for bit."""
        state: dict[str, NDArray[Any]] = {f"field.{k}": v for k, v in self.field.snapshot().items()}
        state.update({name: getattr(self._arrays, name).copy() for name in CHANGING})
        if isinstance(self._model, FullMechanics):
            state.update(self._model.snapshot())
        state["state"] = self._state.copy()
        state["setting"] = np.array([self.machine.t_on_us, self.machine.t_period_us, self._generator_on])
        return state

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a `snapshot` of a plant of the same set-up and resolution."""
        t_on, t_period, on = (float(v) for v in state["setting"])
        if bool(on) != self._generator_on:
            self.switch_generator(bool(on))
        if (t_on, t_period) != (self.machine.t_on_us, self.machine.t_period_us):
            self.set_generator(t_on, t_period)
        self.field.restore({k.removeprefix("field."): v for k, v in state.items() if k.startswith("field.")})
        self._memory.keep_field(self.field.tiles, self.field.index)
        for name in CHANGING:
            getattr(self._arrays, name)[:] = state[name]
        if isinstance(self._model, FullMechanics):
            self._model.restore(state)
        self._state[:] = state["state"]

    def __getstate__(self) -> dict[str, Any]:
        """Return what a pickle or copy needs: the set-up and a snapshot, no addresses."""
        return {
            "machine": self.machine, "mechanics": self.mechanics, "resolution": self._resolution_name,
            "stock": self.field.stock, "window": self._window.copy(), "snapshot": self.snapshot(),
            "pulses": self._pulses,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Build the plant anew and continue where the snapshot was taken."""
        Plant.__init__(
            self, state["machine"], stock=state["stock"], resolution=state["resolution"],
            mechanics=state["mechanics"],
        )
        self.restore(state["snapshot"])
        self._window[:] = state["window"]
        self._pulses = state["pulses"].copy()
        self._memory.keep_pulses(self._pulses)


_NO_STEPS = np.empty((0, 3), np.int64)
