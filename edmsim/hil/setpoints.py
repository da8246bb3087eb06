"""Where the other side wants the axes: places, velocities or steps, made into motor steps frame by frame."""

from __future__ import annotations

import math

AXES = ("X", "Y")
VELOCITY_COUNTS_S = 0.5
"""How long a velocity counts (ours): a sender of velocities repeats them, and a machine whose controller has
gone stands still, as one does whose step pulses stop."""
_NEAR = 1e-6  # share of a step within which a step's place is reached: places are sums of floats


class Setpoints:
    """Setpoints of x and y, from 0 to the travel, which move in motor steps up to a speed."""

    def __init__(self, place_um: tuple[float, float], step_um: float, max_um_s: float, travel_um: float) -> None:
        self._step_um, self._max_um_s, self._travel_um = step_um, max_um_s, travel_um
        self._counted = list(place_um)
        self._now_um = list(place_um)
        self._target_um: list[float | None] = list(place_um)
        self._velocity_um_s = [0.0, 0.0]
        self._until_ns = 0

    @property
    def places_um(self) -> tuple[float, float]:
        """Where the setpoints are now."""
        return self._now_um[0], self._now_um[1]

    def go_to(self, place_um: tuple[float, float]) -> None:
        """Go to a place, each axis at its greatest speed."""
        self._target_um = [self._within(place) for place in place_um]

    def step(self, axis: int, steps: int) -> None:
        """Make some steps of an axis, in front of those that are still to be made."""
        target = self._target_um[axis]
        at = self._counted[axis] if target is None else target
        self._target_um[axis] = self._within(at + steps * self._step_um)

    def move_at(self, velocity_um_s: tuple[float, float], now_ns: int) -> None:
        """Move at a velocity, for at most `VELOCITY_COUNTS_S`; beyond the axes' greatest it is that."""
        most = self._max_um_s
        self._velocity_um_s = [max(-most, min(most, v)) for v in velocity_um_s]
        self._target_um = [None, None]
        self._until_ns = now_ns + round(VELOCITY_COUNTS_S * 1e9)

    def plan(self, start_ns: int, end_ns: int) -> list[tuple[int, int, int]]:
        """Return the motor steps from now until a time at the latest, in order of time."""
        found = []
        for axis in (0, 1):
            speed, seconds = self._speed(axis, start_ns, end_ns)
            if speed == 0.0:
                continue
            way_um = self._within(self._now_um[axis] + speed * seconds) - self._counted[axis]
            direction = 1 if speed > 0 else -1
            for k in range(1, int(direction * way_um / self._step_um + _NEAR) + 1):
                at_um = self._counted[axis] + direction * k * self._step_um
                after_s = max((at_um - self._now_um[axis]) / speed, 0.0)
                found.append((min(start_ns + int(after_s * 1e9), end_ns - 1), axis, direction))
        return sorted(found)

    def keep(self, start_ns: int, end_ns: int, counted_um: tuple[float, float]) -> None:
        """Take in when the frame has ended, and where the steps have led the axes."""
        for axis in (0, 1):
            speed, seconds = self._speed(axis, start_ns, end_ns)
            target = self._target_um[axis]
            reached = self._within(self._now_um[axis] + speed * seconds)
            there = target is not None and abs(target - reached) < _NEAR * self._step_um
            self._now_um[axis] = target if target is not None and there else reached
        self._counted = list(counted_um)

    def snapshot(self) -> tuple[list[list[float]], list[float], list[float], int]:
        """Everything that changes: places, targets (NaN for none), velocity, and until when that counts."""
        targets = [math.nan if target is None else target for target in self._target_um]
        return [self._counted, self._now_um], targets, self._velocity_um_s, self._until_ns

    def restore(self, places: list[list[float]], targets: list[float], velocity: list[float], until_ns: int) -> None:
        """Continue where `snapshot` was taken."""
        self._counted, self._now_um = places
        self._target_um = [None if math.isnan(target) else target for target in targets]
        self._velocity_um_s, self._until_ns = velocity, until_ns

    def _within(self, place_um: float) -> float:
        return max(0.0, min(self._travel_um, place_um))

    def _speed(self, axis: int, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Speed of a setpoint within the frame, and for how long it moves."""
        frame_s = (end_ns - start_ns) * 1e-9
        target = self._target_um[axis]
        if target is not None:
            way = target - self._now_um[axis]
            return math.copysign(self._max_um_s, way) if way else 0.0, min(abs(way) / self._max_um_s, frame_s)
        left_s = max(self._until_ns - start_ns, 0) * 1e-9
        return self._velocity_um_s[axis], min(frame_s, left_s)
