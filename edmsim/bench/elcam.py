"""Speed of cam tables: their figures in ``edmsim bench``."""

from __future__ import annotations

import time

import numpy as np

from edmsim.controllers.axis.elcam.module import CamPlace, Elcam
from edmsim.controllers.axis.elcam.registers import Function, Mode
from edmsim.errors import EdmsimError

POINTS = 1_000_000
"""Points of the table."""
LOOKUPS = 2000
"""Places looked up."""


def elcam_figures() -> dict[str, float]:
    """Processor time: seconds to load a table of a million points, microseconds of a cycle that follows it."""
    points = np.column_stack([np.arange(POINTS, dtype=float), np.arange(POINTS) % 7.0])
    data, master = points.tobytes(), CamPlace()
    elcam = Elcam([CamPlace(), master], buffer_bytes=len(data))
    at = elcam.at(0)
    for function, value in ((Function.BUFFER_SIZE, POINTS), (Function.AXIS, 0), (Function.MASTER, 1)):
        at.write_int(function, value)
    started = time.process_time()
    code = at.load(data)
    status = at.write_int(Function.MODE, Mode.RUN)
    load_s = time.process_time() - started
    if code or status:
        raise EdmsimError(f"a cam table of {POINTS} points was refused: {code!r}, {status!r}")
    started = time.process_time()
    for k in range(LOOKUPS):
        master.setpoint = 7919.7 * k % POINTS
        elcam.follow()
    return {"elcam_load_s": load_s, "elcam_lookup_us": (time.process_time() - started) / LOOKUPS * 1e6}
