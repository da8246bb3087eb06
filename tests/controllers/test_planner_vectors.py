"""Golden vectors of the planners: the steps of random paths and windows, bit for bit as plain Python once made them.

The digests were recorded while a second implementation in plain Python, which counted its ticks one by one, made the
same steps. ``python -m tests.controllers.test_planner_vectors`` prints those of the planners as they are.
"""

import hashlib

import numpy as np
import pytest

from edmsim.controllers.planner.registry import make_planner

SECOND = 1_000_000_000
CASES = 60
DIGESTS = {
    "poscal": "fc971b6f11359cb1", "poscal-literal": "aec15f62487d20a4", "dda": "86d9f12121b90da9",
    "sine-table": "8090d20acdcc22da",
}  # fmt: skip


def case(number):
    """Return a path, with corners near each other or anywhere, its units, windows (speed, duration), the start."""
    rng = np.random.default_rng(number)
    unit = ("um", "step")[number % 2]
    longest = (3, 60, 700, 65_535)[number // 2 % 4]
    moves = rng.integers(-longest, longest + 1, (rng.integers(1, 7), 2))
    points = np.empty((len(moves) + 1, 2), np.int64)
    points[0] = rng.integers(1, 65_535, 2)
    for k, move in enumerate(moves):
        points[k + 1] = np.clip(points[k] + move, 0, 65_535)
    points[-1, 0] += 1 if (points[-1] == points[0]).all() else 0
    speeds = rng.choice([0, 1, -1, 127, -127, *rng.integers(-127, 128, 5).tolist()], 12)
    durations = rng.choice([25_500_000, *rng.integers(0, 40 * SECOND, 3).tolist()], 12)
    windows = list(zip(speeds.tolist(), durations.tolist(), strict=True))
    start_ns = (0, 7 * 3600 * SECOND + 123)[number // 8 % 2]
    return points * (2 if unit == "step" else 1), unit, (262.5, 252.6)[number // 16 % 2], windows, start_ns


def digest(name):
    """Digest of every step, place and length of way in all cases."""
    found = hashlib.sha256()
    for number in range(CASES):
        points, unit, speed_unit, windows, time_ns = case(number)
        planner = make_planner(name, points, speed_unit, unit)
        for speed, duration_ns in windows:
            steps = [tuple(step) for step in planner.advance(time_ns, time_ns + duration_ns, speed)]
            time_ns += duration_ns
            state = tuple(map(int, planner.position_um)), round(planner.path_um, 6), bool(planner.done)
            found.update(repr((steps, state)).encode())
    return found.hexdigest()[:16]


@pytest.mark.parametrize("name", DIGESTS)
def test_steps_and_places_are_those_of_plain_python(name):  # T-69, T-70, T-74
    assert digest(name) == DIGESTS[name]


if __name__ == "__main__":
    print({name: digest(name) for name in DIGESTS})
