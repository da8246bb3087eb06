"""The program's control of generator and wire: codes of the converters, less energy before a corner, wire tension.

The document leaves path-dependent generator control for later. Sparks bend the wire back, so it cuts off corners;
sparks of less energy bend it less. So the routine shortens t(i) before a corner and leaves t(p): the mean current
falls, and the generator accepts the pair of codes.
"""

from __future__ import annotations

from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips.bus import CPORT2, PORT2A, PORT2B
from edmsim.controllers.mcu.chips.dac import COARSE
from edmsim.controllers.mcu.firmware.arithmetic import BYTE


def write_codes(board: Board, t_i: int, t_p: int) -> None:
    """Write both codes, the one that lowers the current first: no pair on the way draws more (row T-34)."""
    bus, lines = board.bus, board.lines
    if (t_i ^ board.codes[0] | t_p ^ board.codes[1]) & COARSE:
        bus.write(PORT2A, 0)
        for line, code in ((lines.t_i_coarse, t_i), (lines.t_p_coarse, t_p)):
            bus.write(CPORT2, line << 1 | bool(code & COARSE))
    order = [(PORT2A, t_i & BYTE), (PORT2B, t_p & BYTE)]
    for address, code in order if (t_i & BYTE) < board.codes[0] & BYTE else reversed(order):
        bus.write(address, code)


def set_tension(board: Board, low: bool) -> None:
    """Lower the wire's tension by a spare line, or give it back in full (row T-85)."""
    board.bus.write(CPORT2, board.lines.low_tension << 1 | low)


def before_corner(t_i: int, to_corner_um: int, reach_um: int, share: int) -> int:
    """Code of t(i) before a corner: within `reach_um`, what `share` / 256 leaves of it, at least 1 where it was."""
    if to_corner_um >= reach_um:
        return t_i
    byte = t_i & BYTE
    return t_i & COARSE | max(byte * min(share, BYTE + 1) >> 8, min(byte, 1))
