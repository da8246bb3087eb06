"""Path-dependent generator control: t(i) and t(p) from the program and from the corner ahead.

The document leaves it for later. Before a corner the wire bends back into the cut and the profile rounds; pulses of
less energy bend it less. So within some distance before a corner t(i) is shortened, t(p) kept: the mean current falls
with it, and no pair is met that the generator refuses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from edmsim.controllers.mcu.arithmetic import BYTE, WORD


class PulseCodes(NamedTuple):
    """Codes of V(t(i)) and V(t(p)), from a place along the path on.

    Attributes
    ----------
    from_um : int
        Place along the path, in um.
    t_i, t_p : int
        0..255.
    """

    from_um: int
    t_i: int
    t_p: int


def codes_at(program: Sequence[PulseCodes], path_um: int) -> PulseCodes:
    """Return what the program wants at a place along the path; its first entry where none has begun."""
    found = program[0]
    for entry in program:
        if entry.from_um > path_um:
            break
        found = entry
    return found


def before_corner(t_i: int, to_corner_um: int, reach_um: int, share: int) -> int:
    """Code of t(i) at some distance before a corner.

    Parameters
    ----------
    t_i : int
        The program's code.
    to_corner_um : int
        Distance to the corner ahead, a word.
    reach_um : int
        Distance from which on t(i) is shortened.
    share : int
        What is left of it, in 1/256.

    Returns
    -------
    int
        At least 1 where the program's is.
    """
    if min(to_corner_um, WORD) >= reach_um:
        return t_i
    return max(t_i * min(share, BYTE + 1) >> 8, min(t_i, 1))
