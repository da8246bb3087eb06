"""Part: a whole part, cut rough and trimmed, where every pass is decided on once."""

from __future__ import annotations

from edmsim.envs.page import page_by
from edmsim.envs.part_page import written
from edmsim.envs.part_task import Part
from edmsim.envs.single import EdmEnv
from edmsim.envs.vector import EdmVectorEnv


@page_by(written)
class PartEnv(EdmEnv):
    """A whole part, cut rough and trimmed: decide on every pass, for time, error and Ra.

    Description
    -----------
    A shop cuts a contour rough and trims it, to and fro on the same kerf, with settings from a technology: the same
    for every machine. Machines differ, and so does what a pass leaves on the wall. Here every pass is decided on
    once, when it is known what the one before left: its set-point, pause, on-time and offset, against those of the
    technology. The cut is that of ``edmsim cut --passes``: with actions of 0 it is that cut bit for bit, if tension
    and constants are not drawn.

    Starting state
    --------------
    The wire is threaded in the start hole. Height, tension and constants of the machine are drawn uniformly within
    their ranges, and the plant's seed; nothing is drawn for the program.

    Versions
    --------
    v0: the first.
    """

    task = Part


class PartVectorEnv(EdmVectorEnv):
    """`PartEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = Part
