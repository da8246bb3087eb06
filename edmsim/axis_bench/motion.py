"""Motion of the bench's axes: drives, motors and tables in compiled code, with either mechanics of the plant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import N_AXES
from edmsim.compiled.jit import compiled
from edmsim.controllers.axis.drive import Drive
from edmsim.errors import EdmsimError, InputError
from edmsim.machine.machine import Machine
from edmsim.plant.axes.board import NOBODY, first_due, serve
from edmsim.plant.axes.drives import AXIS_NAMES, Drives
from edmsim.plant.axes.shaft import coast_all
from edmsim.plant.axes.steps import MOVE, make_steps
from edmsim.plant.constants import screws, table_mechanics
from edmsim.plant.kernel.declare import sizes_of
from edmsim.plant.kernel.state import STATE, Axes
from edmsim.plant.mechanics.mujoco_axes import FullLink, coast_table, lay_out_axes
from edmsim.plant.mechanics.mujoco_table import TableMechanics

# The bench's compiled loop: motion, samples and outputs in time order, and their records.

SAMPLE_ROW = np.dtype(
    [
        ("axis", "i8"), ("time_ns", "i8"), ("setpoint", "i8"), ("count", "i8"), ("command", "f8"), ("pins", "i8"),
        ("duty", "f8"), ("current_A", "f8"), ("place_um", "f8"), ("rotor_um", "f8"), ("speed_rad_s", "f8"),
    ]
)  # fmt: skip
"""A sample as the bench notes it: what the drive read and wrote, and the axis as it was."""
CHANGE_ROW = np.dtype([("axis", "i8"), ("time_ns", "i8"), ("pins", "i8")])
"""A change of a drive's output pins: the bits of ``DRIVE.lines`` from this time on."""
DONE, FULL, LOST = range(3)
"""How a run ended: at its time; early, as the notes were full; with a command or a place that is not a number."""


@compiled
def _note(axes: Axes, axis: int, row: NDArray[np.void]) -> None:
    drive, at = axes.drives[axis], axes.rows[axis]
    row[0].axis = axis
    row[0].time_ns = drive.now_ns
    row[0].setpoint = drive.setpoint
    row[0].count = at.count
    row[0].command = drive.command
    row[0].pins = at.pins
    row[0].duty = at.duty
    row[0].current_A = at.current_A
    row[0].place_um = at.place_um
    row[0].rotor_um = at.rotor_um
    row[0].speed_rad_s = at.speed_rad_s


@compiled
def run(
    state: NDArray[np.void], axes: Axes, link: FullLink | None, moves: NDArray[np.void],
    unplugged: NDArray[np.int64], until_ns: int, samples: NDArray[np.void], changes: NDArray[np.void],
    noted: NDArray[np.int64],
) -> int:
    """Run drives and axes to a time, the table by MuJoCo if there is a `link`; returns `DONE`, `FULL` or `LOST`.

    `samples` and `changes` are room for notes, of which `noted` (2,) counts those there are.
    """
    noted[:] = 0
    if link is not None:
        lay_out_axes(axes, link)
    while True:
        if noted[1] == changes.shape[0] or (samples.shape[0] > 0 and noted[0] == samples.shape[0]):
            return FULL
        who, due_ns = first_due(axes, until_ns)
        if link is not None and not coast_table(state, axes, link, due_ns):
            return LOST
        if not coast_all(axes, 0 if link is None else 2, due_ns):
            return LOST
        axis = who % N_AXES
        if who != NOBODY:
            axes.drives[axis].setpoint += make_steps(moves, axis, unplugged[axis], due_ns)
            pins, samples_before = axes.rows[axis].pins, axes.rows[axis].time_ns
            if not (serve(axes, who, due_ns) and abs(axes.rows[axis].place_um) < 1e9):
                return LOST
            if axes.rows[axis].pins != pins:
                changes[noted[1]].axis, changes[noted[1]].time_ns = axis, due_ns
                changes[noted[1]].pins = axes.rows[axis].pins
                noted[1] += 1
            if samples.shape[0] > 0 and axes.rows[axis].time_ns != samples_before:
                _note(axes, axis, samples[noted[0] : noted[0] + 1])
                noted[0] += 1
        else:
            return DONE


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
