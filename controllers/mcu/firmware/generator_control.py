"""Path-dependent generator control: less energy before a corner.

The document leaves it for later. Before a corner the wire, bent back by its sparks, cuts the corner off; sparks of
less energy bend it less. So t(i) is shortened there and t(p) kept: the mean current falls with it, and no pair of
codes is met that the generator refuses. What the program itself wants is set by `Computer.set_pulse_codes`.
"""

from __future__ import annotations

from edmsim.controllers.mcu.firmware.arithmetic import BYTE


def before_corner(t_i: int, to_corner_um: int, reach_um: int, share: int) -> int:
    """Code of t(i) at some distance before a corner.

    Parameters
    ----------
    t_i : int
        The program's code.
    to_corner_um : int
        Distance to the corner ahead, a word.
    reach_um : int
        Distance below which t(i) is shortened.
    share : int
        What is left of it, in 1/256; 256 leaves it alone.

    Returns
    -------
    int
        At least 1 where the program's is.
    """
    if to_corner_um >= reach_um:
        return t_i
    return max(t_i * min(share, BYTE + 1) >> 8, min(t_i, 1))
