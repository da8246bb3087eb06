"""The leaderboard: a file with every cut of every comparison, from which tables are made again to the digit."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from edmsim import __version__
from edmsim.errors import InputError
from edmsim.evaluation.compare import Comparison
from edmsim.evaluation.episode import Result
from edmsim.evaluation.table import plain_number
from edmsim.files import replacing

FORMAT = "edmsim-leaderboard-1"


def read(file: Path) -> dict[str, Comparison]:
    """Return a leaderboard's comparisons by environment id; an empty dict if the file does not exist.

    Raises
    ------
    InputError
        If the file is not a leaderboard, or is damaged.
    """
    if not file.exists():
        return {}
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if document["format"] != FORMAT:
            raise ValueError(f"its format is {document['format']!r}, not {FORMAT!r}")
        return {env_id: _comparison(env_id, entry) for env_id, entry in document["environments"].items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise InputError(f"this is not a leaderboard, or a damaged one: {error!r}", file) from None


def write(file: Path, comparisons: Sequence[Comparison]) -> None:
    """Write comparisons into a leaderboard; a controller's new results replace its old ones.

    A comparison with other seeds or another resolution replaces all results of its environment.
    """
    board = read(file)
    for made in comparisons:
        before = board.get(made.env_id)
        if before is not None and (before.seeds, before.resolution) == (made.seeds, made.resolution):
            made = Comparison.of(made.env_id, made.resolution, made.seeds, {**before.results, **made.results})
        board[made.env_id] = made
    environments = {env_id: _entry(board[env_id]) for env_id in sorted(board)}
    document = {"format": FORMAT, "edmsim_version": __version__, "environments": environments}
    with replacing(file) as partial:
        partial.write_text(_laid_out(document), encoding="utf-8")


def _comparison(env_id: str, entry: dict[str, Any]) -> Comparison:
    columns, seeds = entry["columns"], tuple(entry["seeds"])

    def values(cut: list[Any]) -> dict[str, Any]:
        return {key: math.nan if value is None else value for key, value in zip(columns, cut, strict=True)}

    results = {
        name: [Result(seed=seed, controller=name, **values(cut)) for seed, cut in zip(seeds, cuts, strict=True)]
        for name, cuts in entry["controllers"].items()
    }
    return Comparison.of(env_id, entry["resolution"], seeds, results)


def _entry(comparison: Comparison) -> dict[str, Any]:
    cuts = [cut for made in comparison.results.values() for cut in made]
    left_out = ["seed", "controller"] + (["ra_um"] if all(math.isnan(cut.ra_um) for cut in cuts) else [])
    columns = [name for name in Result._fields if name not in left_out]
    rows = {
        name: [[plain_number(getattr(cut, column)) for column in columns] for cut in cuts]
        for name, cuts in comparison.results.items()
    }
    return {
        "resolution": comparison.resolution, "seeds": list(comparison.seeds), "columns": columns, "controllers": rows,
    }


def _laid_out(document: dict[str, Any]) -> str:
    """Return JSON with a line per cut, for readable differences."""
    marks: dict[str, str] = {}
    for env_id, entry in document["environments"].items():
        for name, cuts in entry["controllers"].items():
            for k, cut in enumerate(cuts):
                mark = f"@{env_id} {name} {k}@"
                marks[json.dumps(mark)], cuts[k] = json.dumps(cut, allow_nan=False), mark
    text = json.dumps(document, indent=1)
    for mark, row in marks.items():
        text = text.replace(mark, row)
    return text + "\n"
