"""Equal seed, set-up and motion give equal bits, and runs do not affect each other."""

import hashlib
import os
import subprocess
import sys
import tracemalloc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import edmsim

from .conftest import fill

HASH = """
import hashlib, edmsim
plant = edmsim.Plant(edmsim.Machine.load(), seed=11, resolution="fast")
digest = hashlib.sha256()
for n in range(40):
    steps = [(plant.time_ns + k * 5_000_001, k % 2, 1) for k in range(4)]
    digest.update(repr(plant.advance(steps)).encode())
for name, array in sorted(plant.snapshot().items()):
    digest.update(name.encode() + array.tobytes())
print(digest.hexdigest())
"""


def bits(plant):
    """Digest of the whole state of a plant."""
    digest = hashlib.sha256()
    for name, array in sorted(plant.snapshot().items()):
        digest.update(name.encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def physics(plant):
    """Digest of a plant's state that does not depend on which tiles of untouched metal are stored."""
    digest = hashlib.sha256(plant.field.patch(0, 7_900, 8_500, 7_900, 8_500).tobytes())
    for name, array in sorted(plant.snapshot().items()):
        if not name.startswith("field."):
            digest.update(name.encode() + array.tobytes())
    return digest.hexdigest()


def run(plant, n=60, phase=0):
    """Feed at about 25 um/s towards +x and a little y; return the windows in a form in which NaN is equal to NaN."""
    windows = []
    for k in range(n):
        steps = [(plant.time_ns + 1_000_000, 0, 1)] if (k + phase) % 3 else []
        steps += [(plant.time_ns + 9_000_001, 1, -1)] if (k + phase) % 10 == 0 else []
        windows.append(repr(plant.advance(steps)))
    return windows


def plant_of(machine, seed=11, resolution="fast"):
    return edmsim.Plant(machine, seed, resolution=resolution)


@pytest.mark.parametrize("resolution", ["fast", "default", "fine"])
def test_same_seed_same_bits(machine, resolution):
    first, second = plant_of(machine, resolution=resolution), plant_of(machine, resolution=resolution)
    assert run(first) == run(second)
    assert bits(first) == bits(second)


def test_another_seed_other_bits(machine):
    streams = [tuple(run(plant_of(machine, seed))) for seed in (0, 1, 2, 2**31, 2**40)]
    assert len(set(streams)) == 5


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "mechanics", "windows"), [
    ("iso-pulse", "modal", 60), ("iso-energetic", "modal", 60), ("ignition-pulse", "modal", 60),
    ("iso-pulse", "mujoco", 6),
])  # fmt: skip
def test_a_restored_plant_continues_bit_for_bit(mode, mechanics, windows):
    """Also after another setting, a new wire, and with the generator off; the plant's own past has no effect."""
    machine = edmsim.Machine.load(generator=mode)
    plant, other = (edmsim.Plant(machine, seed, resolution="fast", mechanics=mechanics) for seed in (11, 99))
    fresh = bits(plant)
    run(other, windows)
    for change in (
        lambda: run(plant, windows), lambda: plant.set_generator(20, 200),
        lambda: plant.rethread((32_480.0, 33_500.0), 10**9), lambda: plant.switch_generator(False),
    ):
        change()
        state = plant.snapshot()
        ahead, end = run(plant, windows), physics(plant)
        for again in (plant, other):
            again.restore(state)
            assert again.machine == plant.machine
            assert again.generator_on == plant.generator_on
            assert (run(again, windows), physics(again)) == (ahead, end)
    plant.reset(11)
    assert bits(plant) == fresh


def test_a_snapshot_does_not_change_afterwards_and_does_not_disturb(machine):
    plant, reference = plant_of(machine), plant_of(machine)
    run(plant, 20)
    state = plant.snapshot()
    stored = {name: array.tobytes() for name, array in state.items()}
    run(plant, 20, 20)
    assert {name: array.tobytes() for name, array in state.items()} == stored
    run(reference, 40)
    assert bits(plant) == bits(reference)


def test_a_new_wire_starts_at_rest_at_its_place_and_time(machine):
    plant = plant_of(machine)
    run(plant)
    water = "debris", "steam", "gas", "covered", "wake_debris", "wake_gas"
    before = plant.time_ns
    fill(plant, **dict.fromkeys(water, 0.1))
    plant.rethread((30_000.0, 31_000.0), 60 * 10**9)
    assert plant.time_ns == before + 60 * 10**9
    assert plant.commanded_um == (30_000.0, 31_000.0)
    assert not plant.deflections_um().any()
    state = plant.snapshot()
    assert (state["temperature_K"] == 293.0).all()
    assert not any(state[name].any() for name in water)


def in_this_process():
    printed = []
    exec(HASH, {"print": printed.append})
    return printed[0]


@pytest.mark.slow
def test_another_process_gives_the_same_bits(tmp_path):
    found = subprocess.run(
        [sys.executable, "-c", HASH], capture_output=True, text=True, check=True, cwd=tmp_path,
        env={**os.environ, "PYTHONHASHSEED": "7"},
    )
    assert found.stdout.strip() == in_this_process()


def test_plants_in_two_threads_do_what_they_do_alone(machine, drive):
    """The pulse loop holds no lock and shares no data, so other threads do not change the bits."""

    def cut(seed):
        return drive(edmsim.Plant(machine, seed, resolution="fast"), 25.0, 2.0)

    alone = [cut(seed) for seed in range(4)]
    with ThreadPoolExecutor(max_workers=2) as pool:
        assert list(pool.map(cut, range(4))) == alone


@pytest.mark.slow
def test_memory_does_not_grow_but_for_the_tiles_of_the_kerf(machine, drive):
    drive(edmsim.Plant(machine, 2, resolution="fast"), 25.0, 60.0)  # Python keeps up to 2000 freed tuples for reuse
    plant = edmsim.Plant(machine, 1, resolution="fast")
    drive(plant, 25.0, 5.0)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tiles = plant.field.tiles.nbytes
        for _ in range(6):
            drive(plant, 25.0, 10.0)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    # the first tiles were allocated before the measurement, those that replaced them during it
    assert grown - plant.field.tiles.nbytes < 100_000
    assert plant.field.tiles.nbytes > tiles
