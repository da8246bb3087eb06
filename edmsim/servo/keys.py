"""Keys of the UHU's terminal program: the space bar for the analyser, cursors for quick moves, ESC to leave.

Rows U-37 and U-60. Every other key goes to the drive as it is.
"""

from __future__ import annotations

LEAVE = b"\x1b"
"""ESC, where no more follows: it ends the program."""
_MOVES = {
    b"\x1b[C": 32, b"\x1b[A": 32, b"\x1b[D": -32, b"\x1b[B": -32,
    b"\x1b[1;5C": 64, b"\x1b[1;5A": 64, b"\x1b[1;5D": -64, b"\x1b[1;5B": -64,
}  # fmt: skip
"""Counts of the cursor keys, and of those with Ctrl, as terminals send them: right and up are positive."""


def sent_for(keys: bytes, streams: bool, analysing: bool) -> tuple[bytes, bool, bool]:
    r"""Return what some keys, as they came at once, send to a drive.

    Parameters
    ----------
    keys : bytes
    streams : bool
        Whether the drive has an analyser (``A`` and ``Z``) and moves by ``G``, as the UHU; the servo module moves by
        ``+`` and ``-``.
    analysing : bool
        Whether the analyser is on.

    Returns
    -------
    bytes, bool, bool
        What is sent, whether the analyser is on then, and whether the program is to be left.

    Examples
    --------
    >>> sent_for(b" ", True, False)
    (b'A\r', True, False)
    >>> sent_for(b"\x1b[1;5D", False, False)
    (b'-64\r', False, False)
    """
    if keys == LEAVE:
        return b"", analysing, True
    if keys in _MOVES:
        counts = _MOVES[keys]
        return (b"G%d\r" if streams else b"%+d\r") % counts, analysing, False
    if keys == b" " and streams:
        return b"Z\r" if analysing else b"A\r", not analysing, False
    return keys.replace(b"\n", b"\r"), analysing, False
