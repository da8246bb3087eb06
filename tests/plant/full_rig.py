"""Wire and table alone under MuJoCo, moved over many pulses."""

from types import SimpleNamespace

import numpy as np

from edmsim.compiled.jit import compiled
from edmsim.plant.kernel.state import ISO_PULSE, STATE, Axes, Constants, Propagators, Timing, allocate, sizes_of
from edmsim.plant.mechanics.full_model import LOST, DriveSetup, FullMechanics, move_full
from edmsim.plant.mechanics.modal import project
from edmsim.plant.mechanics.model import N_NODES, WireSetup
from tests.plant.arrays import arrays

BRASS = WireSetup(0.25e-3, 8400.0, 10.0, 0.040, 0.2)
SMOOTH = DriveSetup(step_m=2e-6, friction_N=0.0, presliding_m=5e-6, backlash_m=0.0)  # T-16
ALL_MODES = 31  # nodes of the machine's file
PERIOD_NS = 100_000  # 10 kHz
DRY = Constants(*(0.0 for _ in Constants._fields))
"""Constants without water, so without film; the motion needs no others."""
START_UM = 32_500.0


def slice_heights(wire, height_m=0.020, n=9):
    return (wire.guide_distance_m - height_m) / 2 + height_m * (np.arange(n) + 0.5) / n


@compiled
def _pulses(
    state, a, c, axes, link, p, t, load, films, scales, ignite_us, period_ns, kicks, kick_slice, end_us, steps,
    wire, table,
):
    """Move over many pulses; record nodes, and position, rotor and command of the axes, after every pulse."""
    following = 0
    for i in range(kicks.shape[0]):
        following = move_full(
            state, a, c, axes, link, p, t, load, films, 0.0, 0.0, scales[0], scales[1], ignite_us, end_us[i],
            period_ns, kick_slice[i], kicks[i, 0], kicks[i, 1], steps, following,
        )
        if following == LOST:
            return i
        state[0].time_ns += period_ns
        for axis in range(2):
            for m in range(wire.shape[2]):
                wire[i, axis, m] = a.wire_q[axis, m]
            table[i, axis, 0] = state[0].commanded_um[axis] + a.table_q[axis, 0]
            table[i, axis, 1] = state[0].commanded_um[axis] + a.table_q[axis, 1]
            table[i, axis, 2] = state[0].commanded_um[axis]
    return kicks.shape[0]


class Rig:
    """Wire and table alone, at rest."""

    def __init__(self, wire=BRASS, drive=SMOOTH, heights=None, start_um=START_UM):
        self.full = FullMechanics(wire, drive, slice_heights(wire) if heights is None else heights)
        n_slices, n_nodes = self.full.wire_shape.shape
        sizes = sizes_of(n_slices, 32, n_nodes)
        self.arrays = arrays(self.full, sizes, 300.0, {"height_share": np.full(n_slices, 0.5)})
        self.axes = allocate(Axes, sizes, loops=0, errs=0)
        self.propagators = allocate(Propagators, sizes)  # the full model does not use them
        self.timing = Timing(
            mode=ISO_PULSE, open_V=80.0, burning_V=20.0, removal_um3_J=1.0, current_A=1.0, short_A=1.0,
            current_form=1.0, on_us=1.0, wait_us=1.0, arc_share=1.0, pause_us=1.0, period_ns=PERIOD_NS,
            grid_us=0.1,
        )  # fmt: skip
        self.state = np.zeros(1, STATE)
        self.state["commanded_um"][0, :2] = self.state["axis_um"][0, :2] = start_um

    def run(
        self, n, *, kicks=None, at=None, end_us=None, pull=None, scales=(1.0, 1.0), ignite_us=1e9, steps=(),
        period_ns=PERIOD_NS,
    ):
        """Move over `n` pulses; the times of `steps` are relative to the present."""
        a = self.arrays
        sums, load = np.zeros((len(a.shape), 4)), np.zeros_like(a.wire_q)
        if pull is not None:
            sums[:, 2:] = pull
        project(a, sums, load)
        due = [(time + int(self.state["time_ns"][0]), axis, way) for time, axis, way in steps]
        wire, table = np.zeros((n, 2, N_NODES)), np.zeros((n, 2, 3))
        done = _pulses(
            self.state, a, DRY, self.axes, self.full.link, self.propagators, self.timing, load,
            np.zeros((len(a.shape), 6)), scales, ignite_us, period_ns, np.zeros((n, 2)) if kicks is None else kicks,
            np.zeros(n, np.int64) if at is None else at, np.full(n, period_ns * 1e-3) if end_us is None else end_us,
            np.array(due, np.int64).reshape(-1, 3), wire, table,
        )  # fmt: skip
        place, rotor, commanded = np.moveaxis(table, 2, 0)
        return SimpleNamespace(done=done, nodes=wire, place=place, rotor=rotor, commanded=commanded)


def stepping(rate_hz, n, axis=0, way=1):
    """`n` motor steps at a rate per second."""
    return [(round((i + 1) / rate_hz * 1e9), axis, way) for i in range(n)]


def frequency(signal, dt):
    """Frequency from the first to the last rise through zero."""
    k = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    crossing = k - signal[k] / (signal[k + 1] - signal[k])
    return (len(k) - 1) / ((crossing[-1] - crossing[0]) * dt)
