"""Data of the machine: the MuJoCo model, and tables of machines, wires, materials and generators."""

from __future__ import annotations

from pathlib import Path

from edmsim.errors import InputError


def path(name: str) -> Path:
    """Return where a data file lies.

    Parameters
    ----------
    name : str
        The file's place in this folder, for example ``"agiecut_dem15.xml"``.

    Raises
    ------
    InputError
        If there is no such file.
    """
    file = Path(__file__).parent / name
    if not file.is_file():
        raise InputError(f"there is no data file {name!r}; the files lie in {file.parent}")
    return file
