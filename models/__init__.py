"""Data of the machine: the MuJoCo model, tables of machines, wires, materials and generators, published tables."""

import csv
from pathlib import Path

from edmsim.errors import InputError


def path(name: str) -> Path:
    """Return where a data file lies, ``"agiecut_dem15.xml"``; an absolute path stays as it is.

    Raises `InputError` if there is no such file.
    """
    file = Path(__file__).parent / name
    if not file.is_file():
        raise InputError(f"there is no data file {name!r}; the files lie in {file.parent}")
    return file


def policies(env_id: str = "") -> list[str]:
    """Return the names of the policies under ``policies/``, perhaps of those trained in one environment."""
    prefix = f"{env_id.removeprefix('edmsim/').partition('-v')[0]}-" if env_id else ""
    names = sorted(found.stem for found in (Path(__file__).parent / "policies").glob("*.json"))
    return [name for name in names if name.startswith(prefix)]


def published(name: str) -> list[dict[str, str]]:
    """Return the rows of a table under ``published/``, ``"ignition_median_vs_gap_eth"``, by column."""
    with path(f"published/{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))
