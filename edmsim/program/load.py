"""A part program or drawing, read by its suffix."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edmsim.errors import InputError
from edmsim.program.outline import Program

GCODE_SUFFIXES = (".ngc", ".nc", ".gcode", ".iso", ".txt")
"""File suffixes read as G-code; ``.dxf`` is read as a drawing."""


def load_program(
    file: str | Path, *, ignore: Sequence[str] = (), layers: Sequence[str] = (), unit: str | None = None,
    offsets: str | Path | None = None,
) -> Program:
    """Read a part program or drawing, by its suffix.

    Parameters
    ----------
    file : path
        ``.ngc .nc .gcode .iso .txt`` are G-code, ``.dxf`` is a drawing; upper or lower case.
    ignore : sequence of str
        Words of G-code to leave out: `read_gcode`.
    layers, unit
        Of a drawing: `read_dxf`.
    offsets : path, optional
        Table of the offset registers of G-code: `edmsim.program.registers.read_offsets`.

    Returns
    -------
    Program

    Raises
    ------
    InputError
        Another suffix, or whatever `read_gcode` and `read_dxf` refuse.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix == ".dxf":
        if ignore:
            raise InputError("words are ignored in G-code: a drawing has none", path)
        if offsets is not None:
            raise InputError("offset registers are those of G-code: a drawing has none", path)
        from edmsim.program.dxf import read_dxf

        return read_dxf(path, layers, unit)
    if suffix in GCODE_SUFFIXES:
        if layers or unit is not None:
            raise InputError("layers and unit are those of a drawing: G-code has none", path)
        from edmsim.program.gcode import read_gcode
        from edmsim.program.registers import read_offsets

        return read_gcode(path, ignore, {} if offsets is None else read_offsets(offsets))
    known = " ".join(GCODE_SUFFIXES)
    raise InputError(f"unknown suffix '{path.suffix}': give G-code ({known}) or a drawing (.dxf)", path)
