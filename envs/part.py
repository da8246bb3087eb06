"""Part: a whole part, cut rough and trimmed, where every pass is decided on once."""

from __future__ import annotations

from edmsim.envs.environment import EdmEnv
from edmsim.envs.page import page_by
from edmsim.envs.part_page import written
from edmsim.envs.part_task import Part


@page_by(written)
class PartEnv(EdmEnv):
    """A whole part, cut rough and trimmed: decide on every pass, to save time, error and roughness.

    Description
    -----------
    A shop cuts a contour rough and then trims it in the same kerf, with settings from a technology that is the same
    for every machine. But machines differ, and so does the metal that a pass leaves. Here an action decides on one
    pass, after the wall of the pass before was measured: it changes set-point, pause, on-time and offset relative to
    the technology. With actions of 0 the cut equals ``edmsim cut --passes`` bit for bit, if tension and constants
    are not drawn.

    Starting state
    --------------
    The wire is in the start hole. Height, tension and constants of the machine are drawn uniformly within their
    ranges, and so is the plant's seed; the program has no random draws.

    Versions
    --------
    v0: the first.
    """

    task = Part
