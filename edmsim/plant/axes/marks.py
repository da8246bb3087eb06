"""Index marks of the encoder and the home cam on the table, as the two homing inputs of a drive."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edmsim.compiled.axis_rows import INDEX_WIRE
from edmsim.compiled.jit import compiled

BOUNCES = 8  # a contact that bounces opens and closes so often in turn (ours), evenly
LONG_AGO_NS = -(1 << 61)  # when a switch last changed that has not moved yet


@compiled
def mark_below(row: Any, motor: Any) -> int:
    """Number of the index mark that begins at or below the encoder's place."""
    place_um = row.place_um if motor.on_table != 0.0 else row.rotor_um
    mark: int = math.floor((place_um - motor.index_phase_um) / motor.index_um)
    return mark


@compiled
def pass_marks(row: Any, motor: Any, least_ns: int) -> None:
    """Note the index marks passed since the last call; one passed in under `least_ns`, or unplugged, is missed."""
    on_table = motor.on_table != 0.0
    place_um = row.place_um if on_table else row.rotor_um
    speed_um_s = abs(row.speed_um_s if on_table else row.speed_rad_s * motor.um_per_rad)
    mark, before = mark_below(row, motor), row.mark
    row.mark = mark
    begin_um = mark * motor.index_um + motor.index_phase_um
    plugged = row.unplugged & INDEX_WIRE == 0
    row.index_on = 1 if plugged and place_um - begin_um < motor.index_width_um else 0
    if mark == before or not plugged or speed_um_s * least_ns * 1e-9 > motor.index_width_um:
        return
    row.indexes += abs(mark - before)
    passed_um = begin_um if mark > before else begin_um + motor.index_um
    per_um = motor.counts_per_rad / motor.um_per_rad
    row.index_at = row.count - np.int64(math.floor((place_um - passed_um) * per_um + 0.5))


@compiled
def home_level(row: Any, motor: Any, now_ns: float) -> int:
    """Level of the home input at a time; until a change of its bouncing switch has settled it is ``AXIS.home``."""
    since_ns, pulse_ns = now_ns - row.cam_ns, motor.cam_bounce_ns / BOUNCES
    new: int = row.cam
    before: int = row.home
    settled_ns = motor.cam_filter_ns
    if motor.cam_filter_ns >= pulse_ns:
        settled_ns += motor.cam_bounce_ns
    elif since_ns < motor.cam_bounce_ns and since_ns >= motor.cam_filter_ns:
        return new if math.floor((since_ns - motor.cam_filter_ns) / pulse_ns) % 2 == 0 else 1 - new
    return new if since_ns >= settled_ns else before


@compiled
def watch_cam(row: Any, motor: Any, now_ns: float) -> None:
    """Let the home switch close or open where the table stands at a time."""
    place_um, slack_um = row.place_um, motor.cam_hysteresis_um if row.cam != 0 else 0.0
    on = 1 if motor.cam_low_um - slack_um <= place_um <= motor.cam_high_um + slack_um else 0
    if on != row.cam and motor.cam_low_um != motor.cam_high_um:
        row.home = home_level(row, motor, now_ns)
        row.cam = on
        row.cam_ns = np.int64(now_ns)
