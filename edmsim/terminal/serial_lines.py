"""The two serial lines: what the operator types and sees, and the host's program, through the program's streams."""

from __future__ import annotations

from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.firmware.memory_map import CIADR, HOST_IN, TERMINAL_IN


class SerialLines:
    """Bytes through the 8251s and the routines that CIADR and COADR name (rows T-58, T-59).

    Parameters
    ----------
    computer : Computer
    """

    def __init__(self, computer: Computer) -> None:
        self._computer = computer

    def heard(self, data: bytes) -> bytes:
        """Return what the program fetches of the bytes an operator sent; sparks may disturb them."""
        return self._fetch(data, from_host=False)

    def heard_from_host(self, data: bytes) -> bytes:
        """Return what the program fetches of the bytes the host sent: the input stream is redirected meanwhile."""
        self._computer.store(CIADR, HOST_IN)
        try:
            return self._fetch(data, from_host=True)
        finally:
            self._computer.store(CIADR, TERMINAL_IN)

    def spoken(self, data: bytes) -> bytes:
        """Return what arrives at the operator's screen of the bytes the program sends."""
        board = self._computer.board
        for byte in data:
            self._computer.streams.co(byte)
        sent = bytes(board.sent)
        board.sent.clear()
        noise = board.faults.noise
        return sent if noise is None else bytes(noise(byte, board.mean_current_A) for byte in sent)

    def _fetch(self, data: bytes, from_host: bool) -> bytes:
        fetched = bytearray()
        for byte in data:
            self._computer.board.receive(byte, from_host)
            character = self._computer.streams.ci()
            if character is not None:
                fetched.append(character)
        return bytes(fetched)
