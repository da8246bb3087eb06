"""What can be seen of a plant without moving it: places, metal, wire, rays, and the last window's pulses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.axes.drives import AXIS_NAMES, Drives
from edmsim.plant.axes.trips import reason, reason_of_delay
from edmsim.plant.gap.equalising import OppositePulses, opposite_pulses
from edmsim.plant.gap.rays import Rays
from edmsim.plant.kernel.state import BARE, GRID, PULSE, Arrays, Constants, Timing
from edmsim.plant.resolution import Resolution
from edmsim.plant.settings import GeneratorSetting
from edmsim.plant.window import read_window
from edmsim.plant.workpiece.kerf_field import KerfField

if TYPE_CHECKING:
    from edmsim.machine.machine import Machine


class PlantReadings:
    """Measurements of a plant; see `edmsim.plant.plant.Plant`."""

    field: KerfField
    mechanics: str
    resolution: Resolution
    _state: NDArray[np.void]
    _window: NDArray[np.void]
    _window_bytes: memoryview
    _arrays: Arrays
    _constants: Constants
    _setting: GeneratorSetting
    _drives: Drives
    _pulses: NDArray[np.void]

    def __repr__(self) -> str:
        """Say what is set up, and where and when it is."""
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
        """Setpoint of u and v: by how much the upper guide is to lead the lower one."""
        u, v = self._state["commanded_um"][0, 2:]
        return float(u), float(v)

    @property
    def axes_um(self) -> tuple[float, float, float, float]:
        """Where the axes x, y, u, v are, less what the table rings after motor steps."""
        x, y, u, v = self._state["axis_um"][0]
        return float(x), float(y), float(u), float(v)

    @property
    def place_um(self) -> tuple[float, float]:
        """Where the axes really are: the position counter knows neither of ringing nor of lost steps (row T-19)."""
        x, y = self._state["axis_um"][0, :2] + (self._arrays.table_shape * self._arrays.table_q).sum(axis=1)
        return float(x), float(y)

    @property
    def machine(self) -> Machine:
        """The set-up, with the pulse setting in force."""
        return self._setting.machine

    @property
    def generator_on(self) -> bool:
        """Whether the generator runs; a fresh plant's does."""
        return self._setting.on

    @property
    def following_error_um(self) -> tuple[float, float]:
        """How far x and y are behind their commanded position; nil under a stepper, which nobody looks after."""
        return self.following_error_in_um(self._state[0])

    def following_error_in_um(self, state: np.void) -> tuple[float, float]:
        """Return the following error that a record of `STATE` of this plant tells, also a former one."""
        x, y = state["commanded_um"][:2] - state["indicated_um" if self._drives.axes.errs else "axis_um"][:2]
        return float(x), float(y)

    @property
    def drive_faults(self) -> int:
        """Which axes have to stop: bit 0 for x, 1 for y, 2 for u, 3 for v.

        Its drive reports a fault, or commands what is not a share of its supply; or the table is further from where
        its steps lead it than the wire's radius, so that the wire does not touch its path any more.
        """
        return self._drives.faults()

    @property
    def fault_reason(self) -> str:
        """Why the axes of `drive_faults` have to stop, in words; nothing if there are none."""
        return reason(self._drives)

    @property
    def away_um(self) -> NDArray[np.float64]:
        """How far x, y, u and v are from where their steps lead them; 0 under a stepper, which nobody looks after."""
        return self._drives.away_um(self._state)

    def reason_of_delay(self, late_s: float) -> str:
        """Say which axes are not in place, if any, and what keeps them; they would take so long (s) to be."""
        return "" if self.in_place else reason_of_delay(self._drives, self.away_um, self._constants.step_um, late_s)

    @property
    def in_place(self) -> bool:
        """Whether all axes whose drives have a loop are within a step of where their steps lead them."""
        return bool(np.all(self.away_um <= self._constants.step_um))

    @property
    def own_step_um(self) -> dict[str, float]:
        """What a step edge asks an axis' drive to move its table by, for every axis whose drive has a loop."""
        return {name: self._drives.step_um(k) for k, name in enumerate(AXIS_NAMES) if self._drives.has_loop(k)}

    @property
    def window_ns(self) -> int:
        """Duration of a window at the present setting; 0 where the period varies (row T-42)."""
        return WINDOW_PULSES * self._setting.timing.period_ns

    @property
    def longest_window_ns(self) -> int:
        """Upper bound of a window's duration at the present setting."""
        return self.window_ns or WINDOW_PULSES * math.ceil(self._setting.timing.grid_us * GRID * 1e3)

    @property
    def removed_mm3(self) -> float:
        """Metal removed so far: what is carved from the kerf field, and what waits for it on the rays."""
        return float(self.field.removed_um2 + self._arrays.pending_um2.sum()) * self._constants.slice_um * 1e-9

    @property
    def craters_mm3(self) -> float:
        """Metal the discharges removed so far, added up crater by crater."""
        s = self._state[0]
        pending_um3 = float(self._arrays.carry_um2.sum()) * self._constants.slice_um
        return float(s["crater_um3"] - s["missed_um3"] - pending_um3) * 1e-9

    @property
    def broken_height_mm(self) -> float:
        """Height above the workpiece's lower face at which the wire broke."""
        middle = float(self._state["broken_slice"][0]) + 0.5
        return middle * self._constants.slice_um * 1e-3

    def deflections_um(self) -> NDArray[np.float64]:
        """Deflection of the wire now, (slices, 2): x and y from the line between the guides."""
        return self._arrays.shape @ self._arrays.wire_q.T

    def coverage(self) -> NDArray[np.float64]:
        """Share of the wire's front that gas covers now, (slices,) from the lowest: 0 to 1."""
        return self._arrays.covered[: len(self._arrays.debris)].copy()

    def rays(self) -> Rays:
        """Every slice's rays as the loop sees them: as they were traced, less what craters took since."""
        return Rays(*(getattr(self._arrays, name).copy() for name in Rays._fields))

    @property
    def timing(self) -> Timing:
        """The generator's present setting as the loop has it: voltages, currents, times."""
        return self._setting.timing

    def leakage_S(self) -> float:
        """Return the conductance of the water between wire and metal, by the rays as they are; 0 without a wire."""
        if self._state["broken"][0] == BARE:
            return 0.0
        reach_um = np.maximum(self._arrays.distance[:, : self._arrays.edge_um.shape[1]], 1.0)
        return float((1.0 / reach_um.astype(np.float64)).sum()) * self._constants.leak_S_um

    def opposite_pulses(self) -> OppositePulses | None:
        """Return the equalising pulses of the last window, fired at the present setting; None without a supply."""
        circuit = self.machine.generator.equalising if self.generator_on else None
        if circuit is None:
            return None
        return opposite_pulses(read_window(self._window_bytes), self.timing, circuit, self.leakage_S())

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
