"""What controllers and policies are worth away from where they were trained: finer physics, and other machines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from edmsim.evaluation.compare import Figure, check, mean, run
from edmsim.evaluation.table import shown

if TYPE_CHECKING:
    from rich.table import Table

USUAL_CUTS = 6
"""Ours: in each of eight places, and those at finer resolutions take long."""


class Place(NamedTuple):
    """Where a policy is taken to.

    Attributes
    ----------
    name : str
        What the table calls it.
    resolution : {"fast", "default", "fine"}
    options : dict
        Arguments of the environment that differ.
    """

    name: str
    resolution: str
    options: dict[str, Any]


PLACES = (
    Place("as trained", "fast", {}),
    Place("resolution default", "default", {}),
    Place("resolution fine", "fine", {}),
    Place("higher: 40 to 60 mm", "fast", {"height_mm": (40.0, 60.0)}),
    Place("lower: 2 to 4 mm", "fast", {"height_mm": (2.0, 4.0)}),
    Place("slack wire: 4 to 8 N", "fast", {"tension": (4.0, 8.0)}),
    Place("carbide", "fast", {"materials": ("cemented-carbide",)}),
    Place("copper", "fast", {"materials": ("copper",)}),
)
"""The environments' own ranges are 4 to 40 mm, 8 to 20 N, and tool steel; these are beyond (ours)."""


class Moved(NamedTuple):
    """What a controller did in a place.

    Attributes
    ----------
    place, controller : str
    total_return, rate_mm2_min : Figure
        Means over the cuts; a lost wire costs the rate the time for threading another.
    lost : int
        Cuts that ended by a broken wire or a jam.
    """

    place: str
    controller: str
    total_return: Figure
    rate_mm2_min: Figure
    lost: int


def transfer(
    env_id: str, controllers: Sequence[str], seeds: int = USUAL_CUTS, *,
    watch: Callable[[int, int], None] | None = None,
) -> list[Moved]:
    """Have controllers make the same cuts in every one of `PLACES`.

    Parameters
    ----------
    env_id : str
    controllers : sequence of str
        See `edmsim.controllers.from_text`.
    seeds : int
        Cuts of each controller in each place, 2 or more, with held-back seeds.
    watch : callable, optional
        Called with the cuts done and the cuts to do.

    Raises
    ------
    InputError
        An unknown environment or controller, or fewer than 2 seeds.
    """
    check(env_id, controllers, seeds, None)
    each, found = len(controllers) * seeds, []
    for number, place in enumerate(PLACES):
        def told(done: int, _: int, before: int = number * each) -> None:
            if watch is not None:
                watch(before + done, len(PLACES) * each)

        made = run(env_id, controllers, seeds, place.resolution, told, **place.options)
        for name, cuts in made.items():
            returns = np.array([cut.total_return for cut in cuts])
            rates = np.array([cut.rate_mm2_min for cut in cuts])
            lost = sum(cut.broke or cut.jammed for cut in cuts)
            found.append(Moved(place.name, name, mean(returns), mean(rates), lost))
    return found


def rows_of(moved: Sequence[Moved]) -> list[list[str]]:
    """Return the cells of the table: place, then return, rate and lost wires of every controller."""
    return [
        [place.name, *(
            f"{shown('total_return', row.total_return)}; {row.rate_mm2_min.value:.1f}; {row.lost}"
            for row in moved if row.place == place.name
        )]
        for place in PLACES
    ]


def render(env_id: str, moved: Sequence[Moved], seeds: int) -> Table:
    """Return the table for the screen."""
    from rich.table import Table

    controllers = [row.controller for row in moved if row.place == PLACES[0].name]
    title = f"{env_id}, {seeds} cuts in each place: return; mm2/min; wires lost and jams"
    table = Table("place", *controllers, title=title)
    for cells in rows_of(moved):
        table.add_row(*cells)
    return table
