"""A simulated log of a machine whose constants are known, at two feeds."""

from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

import edmsim
from edmsim.calibration.log import COLUMNS
from edmsim.closed_loop.straight import Traverse, begin
from edmsim.controllers import make
from edmsim.machine.ranges import with_values

TRUTH = {"gap.particle_share": 0.07, "material.removal_mm3_J": 7.5e-3}


def simulated_log(machine, feeds, seed, windows=990):
    """Cut straight at one feed after the other, or a controller's, and keep what a machine shows of it."""
    rows = []
    for number, feed in enumerate(feeds):
        traverse = Traverse(begin(machine, seed + number), feed)
        for _ in range(windows):
            feed_um_s = traverse.feed_um_s
            w = traverse.window()
            rows.append((feed_um_s, w.short, w.open, w.mean_voltage_V, w.mean_current_A, w.mean_delay_us,
                         machine.t_on_us, machine.t_period_us))  # fmt: skip
    return pa.table(dict(zip(COLUMNS, np.array(rows, float).T, strict=True)))


@pytest.fixture(scope="session")
def known():
    """Give the set-up as its files have it, the constants of the machine that was logged, and its log."""
    machine = edmsim.Machine.load(height_mm=10.0)
    table = simulated_log(with_values(machine, TRUTH), (22, 34), 900)
    return SimpleNamespace(machine=machine, truth=TRUTH, table=table)


@pytest.fixture(scope="session")
def steered():
    """Give the same of a machine that removes little and was logged under the count law, near its greatest feed.

    With the files' constants a cut at the feed of that log stands mostly open; with a little less removal it jams.
    The controller holds a steady feed after 80 s; stretches of it follow.
    """
    machine = edmsim.Machine.load(height_mm=18.0)
    truth = {"gap.particle_share": 0.04, "material.removal_mm3_J": 5.9e-3}
    table = simulated_log(with_values(machine, truth), [make("counts")], 300, 4000)
    return SimpleNamespace(machine=machine, truth=truth, table=table)
