"""The bench's compiled loop: motion, samples and outputs in time order, and their records."""

import numpy as np

from edmsim.compiled.axis_rows import N_AXES
from edmsim.compiled.jit import compiled
from edmsim.plant.axes.board import NOBODY, first_due, serve
from edmsim.plant.axes.feed_drive import coast_all
from edmsim.plant.axes.steps import make_steps
from edmsim.plant.kernel.state import Axes
from edmsim.plant.mechanics.full_model import FullLink, coast_table, copy_axes_to_mujoco

Rows = np.typing.NDArray[np.void]
SAMPLE_ROW = np.dtype(
    [
        ("axis", "i8"), ("time_ns", "i8"), ("setpoint", "i8"), ("count", "i8"), ("command", "f8"), ("pins", "i8"),
        ("duty", "f8"), ("current_A", "f8"), ("place_um", "f8"), ("rotor_um", "f8"), ("speed_rad_s", "f8"),
    ]
)  # fmt: skip
"""Record of a sample: inputs and outputs of the drive, and the state of the axis."""
CHANGE_ROW = np.dtype([("axis", "i8"), ("time_ns", "i8"), ("pins", "i8")])
"""A change of a drive's output pins: the bits of ``DRIVE.lines`` from this time on."""
DONE, FULL, LOST = range(3)
"""How a run ended: at its time; early, because the records were full; with an invalid command or position."""


@compiled
def _note(axes: Axes, axis: int, row: Rows) -> None:
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
    state: Rows, axes: Axes, link: FullLink | None, moves: Rows, unplugged: np.typing.NDArray[np.int64],
    until_ns: int, samples: Rows, changes: Rows, noted: np.typing.NDArray[np.int64],
) -> int:
    """Run drives and axes to a time, the table by MuJoCo if there is a `link`; returns `DONE`, `FULL` or `LOST`.

    `samples` and `changes` are filled with records; `noted` (2,) has their numbers.
    """
    noted[:] = 0
    if link is not None:
        copy_axes_to_mujoco(axes, link)
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
