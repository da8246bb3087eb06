"""Set-ups shared by the tests of the plant: a hole with known gap and few effects, motor steps at fixed speed."""

import pytest

import edmsim
from edmsim import models
from edmsim.validation import setups


def fill(plant, **values):
    """Set arrays of a plant's state, those along the wire in all its slices."""
    state = plant.snapshot()
    for name, value in values.items():
        state[name][: plant.resolution.slices] = value
    plant.restore(state)


@pytest.fixture(scope="session")
def machine():
    return edmsim.Machine.load()


@pytest.fixture(scope="session")
def published():
    """Rows of a published table as dictionaries of floats."""

    def read(name):
        return [{key: float(value) for key, value in row.items()} for row in models.published(name)]

    return read


@pytest.fixture(scope="session")
def altered():
    """Replace constants, also beyond their ranges."""
    return setups.altered


@pytest.fixture(scope="session")
def in_a_hole():
    """A plant whose wire is in the middle of a round hole, and whose discharges have (nearly) no effect."""
    quiet = {
        "material.removal_mm3_J": 1e-15, "base.discharge.impulse_10mJ_Ns": 0.0, "base.discharge.bubble_share": 1e-12,
        "base.gas.steam_share": 0.0, "base.gas.permanent_share": 0.0, "material.magnetic_share": 0.0,
        "base.cooling.wire_heat_share": 0.0, "base.dielectric.conductivity_uS_cm": 1e-9,
        "base.dielectric.permittivity": 1e-6,
    }  # fmt: skip

    def make(machine, gap_um, *, seed=1, resolution="fast", still=True, **constants):
        machine = setups.altered(machine, (quiet if still else {}) | constants)
        return setups.in_a_hole(machine, gap_um, seed, resolution=resolution)

    return make


@pytest.fixture(scope="session")
def drive():
    """Advance a plant for some seconds, or until its wire breaks, with steps along an axis at a fixed speed."""

    def run(plant, speed_um_s, seconds, axis=0):
        direction = 1 if speed_um_s > 0 else -1
        windows, end = [], plant.time_ns + round(seconds * 1e9)
        interval = round(plant.machine.base.table.step_um.value / abs(speed_um_s) * 1e9)
        due = plant.time_ns + interval
        while plant.time_ns < end and not (windows and windows[-1].broken):
            until = plant.time_ns + plant.longest_window_ns
            windows.append(plant.advance([(t, axis, direction) for t in range(due, until, interval)]))
            while due < plant.time_ns:
                due += interval
        return windows

    return run


@pytest.fixture(scope="session")
def share():
    """Share of a class of pulses in some windows."""

    def of(windows, name):
        return sum(getattr(w, name) for w in windows) / sum(w.pulses for w in windows)

    return of
