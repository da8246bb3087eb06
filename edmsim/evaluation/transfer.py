"""What controllers and policies are worth away from where they were trained: finer physics, and other machines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from edmsim.envs.arguments import ends_of
from edmsim.envs.registry import make_family
from edmsim.evaluation.compare import Figure, check, mean, run
from edmsim.evaluation.table import shown
from edmsim.runs import RunTable

if TYPE_CHECKING:
    from edmsim.screen import ScreenTable

USUAL_CUTS = 6  # ours: in each of some eight places, and those at finer resolutions take long


class Place(NamedTuple):
    """Conditions in which a transfer tests a controller.

    Attributes
    ----------
    name : str
        Name in the table.
    resolution : {"fast", "default", "fine"}
    options : dict
        Overrides of the environment's arguments.
    """

    name: str
    resolution: str
    options: dict[str, Any]


BEYOND = 1.5, 0.5
"""Factors on the upper and the lower end of an environment's ranges, for conditions beyond them (ours)."""


def places(env_id: str) -> tuple[Place, ...]:
    """Return the resolutions, and conditions beyond the ranges of height and tension if there are such ranges."""
    family = make_family(env_id)
    more, less = BEYOND
    found = [
        Place("as trained", "fast", {}), Place("resolution default", "default", {}),
        Place("resolution fine", "fine", {}),
    ]
    if family.height_mm is not None:
        low, high = ends_of("height_mm", family.height_mm)
        found.append(Place(f"higher: {high:g} to {more * high:g} mm", "fast", {"height_mm": (high, more * high)}))
        found.append(Place(f"lower: {less * low:g} to {low:g} mm", "fast", {"height_mm": (less * low, low)}))
    if family.tension is not None:
        low, _ = ends_of("tension", family.tension)
        found.append(Place(f"slack wire: {less * low:g} to {low:g} N", "fast", {"tension": (less * low, low)}))
    found.append(Place("carbide", "fast", {"materials": ("cemented-carbide",)}))
    return (*found, Place("copper", "fast", {"materials": ("copper",)}))


class TransferRow(NamedTuple):
    """Result of a controller in one of the `places`.

    Attributes
    ----------
    place, controller : str
    total_return, rate_mm2_min : Figure
        Means over the cuts; in the rate, every broken wire adds the threading time.
    lost : int
        Number of wire breaks and jams.
    """

    place: str
    controller: str
    total_return: Figure
    rate_mm2_min: Figure
    lost: int


def transfer(
    env_id: str, controllers: Sequence[str], seeds: int = USUAL_CUTS, *,
    watch: Callable[[int, int], None] | None = None, table: RunTable | None = None,
) -> list[TransferRow]:
    """Compare controllers by the same cuts in each of an environment's `places`.

    Parameters
    ----------
    env_id : str
    controllers : sequence of str
        See `edmsim.controllers.from_text`.
    seeds : int
        Number of held-back seeds, 2 or more: cuts of each controller in each place.
    watch : callable, optional
        Called with the number of finished cuts and of all cuts.
    table : edmsim.runs.RunTable, optional
        Finished cuts; see `edmsim.evaluation.compare.evaluate`.

    Raises
    ------
    InputError
        If an environment or controller is unknown, or `seeds` is below 2.
    """
    check(env_id, controllers, seeds, None)
    everywhere, each, found = places(env_id), len(controllers) * seeds, []
    for number, place in enumerate(everywhere):
        def report_progress(done: int, _: int, before: int = number * each) -> None:
            if watch is not None:
                watch(before + done, len(everywhere) * each)

        made = run(env_id, controllers, seeds, place.resolution, report_progress, table=table, **place.options)
        for name, cuts in made.items():
            returns = np.array([cut.total_return for cut in cuts])
            rates = np.array([cut.rate_mm2_min for cut in cuts])
            lost = sum(cut.wires_lost + cut.jammed for cut in cuts)
            found.append(TransferRow(place.name, name, mean(returns), mean(rates), lost))
    return found


def rows_of(moved: Sequence[TransferRow]) -> list[list[str]]:
    """Return the cells of the table: place, then return, rate and lost wires of every controller."""
    return [
        [place, *(
            f"{shown('total_return', row.total_return)}; {row.rate_mm2_min.value:.1f}; {row.lost}"
            for row in moved if row.place == place
        )]
        for place in dict.fromkeys(row.place for row in moved)
    ]


def render(env_id: str, moved: Sequence[TransferRow], seeds: int) -> ScreenTable:
    """Return the table for the terminal."""
    from edmsim.screen import ScreenTable

    controllers = [row.controller for row in moved if row.place == moved[0].place]
    title = f"{env_id}, {seeds} cuts in each place: return; mm2/min; wires lost and jams"
    table = ScreenTable("place", numbers=controllers, title=title)
    for cells in rows_of(moved):
        table.add_row(*cells)
    return table
