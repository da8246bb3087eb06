"""Motion of the bench's axes: drives, motors and tables in compiled code, with either mechanics of the plant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.axis_bench.loop import CHANGE_ROW, DONE, LOST, SAMPLE_ROW, run
from edmsim.compiled.axis_rows import N_AXES
from edmsim.controllers.axis.drive import Drive
from edmsim.errors import EdmsimError, InputError
from edmsim.machine.machine import Machine
from edmsim.plant.axes.drives import AXIS_NAMES, Drives
from edmsim.plant.axes.steps import MOVE
from edmsim.plant.constants import screws, table_mechanics
from edmsim.plant.kernel.declare import sizes_of
from edmsim.plant.kernel.state import STATE
from edmsim.plant.mechanics.mujoco_table import TableMechanics

_CHANGES, _SAMPLES = 64, 4096  # room for notes of one compiled run (ours)
_LONGEST_US = 100.0
"""Time step of MuJoCo (ours): 0.2 of the radian of the swing of the DEM-15's carriages on their screws."""


class BenchAxes:
    """Drives by axis, copied and on from time 0, the steps still to come, and what is noted of them."""

    def __init__(self, drives: Mapping[str, Drive], mechanics: str, machine: Machine | None, seed: int) -> None:
        if mechanics not in ("modal", "mujoco"):
            raise InputError(f"there are no mechanics {mechanics!r}; choose modal or mujoco")
        if mechanics == "mujoco":
            machine = machine or Machine.load()
        travel_um = machine.base.table.travel_mm.value * 1e3 if machine else np.inf
        self.drives = Drives(drives, travel_um, sizes_of(1, 8, 1), screws(machine) if machine else None)
        if not drives or self.drives.axes.loops != len(drives):
            raise InputError("a bench needs drives with a loop: a motor and a sample")
        place_um = np.zeros(N_AXES)
        if machine:
            place_um[:2] = machine.base.table.centre_um
        self.drives.switch_on(place_um, seed)
        self._table = table_mechanics(machine, _LONGEST_US) if machine and mechanics == "mujoco" else None
        self._state = np.zeros(1, STATE)
        if self._table is not None:
            self._put_into(self._table, place_um)
        self.now_ns = 0
        self.trace = False  # whether samples are noted
        self.moves: NDArray[np.void] = np.zeros(0, MOVE)
        self.unplugged = np.zeros(N_AXES, np.int64)  # bits of `steps` of every axis
        self._notes = np.zeros(_SAMPLES, SAMPLE_ROW), np.zeros(_CHANGES, CHANGE_ROW), np.zeros(2, np.int64)
        self._samples: list[NDArray[np.void]] = []
        self._changes: list[NDArray[np.void]] = []

    def _put_into(self, table: TableMechanics, place_um: NDArray[np.float64]) -> None:
        """Put the motors into MuJoCo's model; an axis without one rests under its stepper."""
        self._state["commanded_um"] = self._state["axis_um"] = place_um
        for axis in range(2):
            table.link.qpos[table.link.carriage[axis]] = place_um[axis] * 1e-6
            table.link.qpos[table.link.rotor[axis]] = place_um[axis] * table.link.rad_per_um[axis]
            if self.drives.has_loop(axis):
                table.set_motor(axis, self.drives.axes.motors[axis : axis + 1])

    def run_to(self, until_ns: int) -> None:
        """Let time pass until then; `EdmsimError` if an axis is out of range, or commanded above its supply."""
        samples, changes, noted = self._notes
        traced = samples if self.trace else samples[:0]
        axes, link = self.drives.axes, self._table.link if self._table else None
        self._state["time_ns"] = self.now_ns
        end = None
        while end != DONE:
            end = run(self._state, axes, link, self.moves, self.unplugged, until_ns, traced, changes, noted)
            if self.trace:
                self._samples.append(samples[: noted[0]].copy())
            if noted[1]:
                self._changes.append(changes[: noted[1]].copy())
            if end == LOST:
                raise EdmsimError("a drive commands what is not a share of its supply, or its axis has run away")
        self.now_ns = until_ns
        if len(self.moves):
            self.moves = self.moves[self.moves["made"] < np.abs(self.moves["count"])]

    def note_pins(self, axis: int, before: int) -> None:
        """Note the pins of an axis, by its number, if they are not those before."""
        pins = int(self.drives.axes.rows["pins"][axis])
        if pins != before:
            self._changes.append(np.array([(axis, self.now_ns, pins)], CHANGE_ROW))

    def samples(self, axis: str) -> NDArray[np.void]:
        """Return an axis' samples noted since the last call."""
        return _taken(self._samples, SAMPLE_ROW, axis)

    def changes(self, axis: str) -> NDArray[np.void]:
        """Return the changes of an axis' pins since the last call."""
        return _taken(self._changes, CHANGE_ROW, axis)

    def snapshot(self) -> dict[str, Any]:
        """Return what moves."""
        return {
            **self.drives.snapshot(), "motors": self.drives.axes.motors.copy(), "moves": self.moves.copy(),
            "time_ns": self.now_ns,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take back a `snapshot` of the same drives."""
        self.drives.restore(state)
        self.drives.axes.motors[:] = state["motors"]
        self.moves, self.now_ns = state["moves"].copy(), state["time_ns"]


def _taken(parts: list[NDArray[np.void]], kind: np.dtype[np.void], axis: str) -> NDArray[np.void]:
    """Take an axis' rows out of notes, and leave the others'."""
    rows = np.concatenate(parts) if parts else np.zeros(0, kind)
    own: NDArray[np.bool_] = rows["axis"] == AXIS_NAMES.index(axis)
    parts[:] = [rows[~own]]
    found: NDArray[np.void] = rows[own]
    return found
