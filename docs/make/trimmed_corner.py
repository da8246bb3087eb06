"""Why trims round an outer corner, and how to avoid it: `python docs/make/trimmed_corner.py` prints two tables.

They are in theory/passes.md. One has the displacement of the last pass's wire from the wall before the corner, and
its error at the corner, at several tensions. The other has this error by number of passes, with and without the
technologies' longer period before corners.
"""

import numpy as np
from sections import table

from edmsim.closed_loop.simulation import Simulation
from edmsim.machine.technology import Technology, technology_for
from edmsim.validation.passes import CORNER_MM, HEIGHT_MM, cut_corner

SIDE_MM, SEED = 0.8, 1
NEAR_UM, FAR_UM = 150.0, 350.0
"""Distances from the corner between which the wire is measured, because its displacement is constant there."""
CASES = ((2, 1.0), (3, 0.7), (3, 1.0), (3, 1.3))
"""Number of passes, and tension of the last one over the technology's."""


MATERIALS, MATERIALS_SEED = {"tool-steel": 7, "aluminium": 4, "cemented-carbide": 4}, 11
"""Materials with a technology, and their greatest numbers of passes; another seed than the technologies' choice."""


def careless(technology: Technology) -> Technology:
    """Return a technology whose trims do not change their period before corners."""
    heights = tuple(
        at.model_copy(update={"passes": tuple(one.model_copy(update={"corner_before_um": 0.0}) for one in at.passes)})
        for at in technology.heights
    )
    return technology.model_copy(update={"heights": heights})


def tightened(technology: Technology, passes: int, share: float) -> Technology:
    """Return a technology with another tension of the last of `passes` passes."""
    at = next(one for one in technology.heights if one.height_mm == HEIGHT_MM)
    last = at.passes[passes - 1]
    assert last.tension_N is not None
    rows = [*at.passes[: passes - 1], last.model_copy(update={"tension_N": last.tension_N * share})]
    return technology.model_copy(update={"heights": (at.model_copy(update={"passes": tuple(rows)}),)})


def measured(passes: int, share: float) -> tuple[float, float]:
    """Return the mean push of the wire from the wall and the corner's error, in um."""
    pushes: list[float] = []

    def look(simulation: Simulation) -> None:
        if simulation.leg < len(simulation.legs) - 1:
            return
        x, y = np.array(simulation.commanded_um) - simulation.path.contours[0].nominal_mm[1] * 1e3
        push = simulation.plant.deflections_um().mean(axis=0)
        pushes.extend(
            float(push[axis])
            for axis, before in ((1, -x), (0, -y))  # the wire is above the first side, and right of the second
            if NEAR_UM <= before <= FAR_UM
        )

    technology = tightened(careless(technology_for("tool-steel")), passes, share)
    corner = cut_corner(technology, passes, SEED, SIDE_MM, look)
    return float(np.mean(pushes)), corner.corner_um


def by_passes() -> None:
    """Print the error by number of passes."""
    most = max(MATERIALS.values())
    rows = []
    for material, passes in MATERIALS.items():
        own = technology_for(material)
        for name, technology in ((f"{material}, without it", careless(own)), (material, own)):
            found = [cut_corner(technology, n, MATERIALS_SEED, CORNER_MM) for n in range(1, passes + 1)]
            rows.append([name, *(f"{corner.corner_um:.1f}" for corner in found), *[""] * (most - passes)])
    print(table(["passes", *map(str, range(1, most + 1))], rows, numbers=most))


def main() -> None:
    """Print the tables."""
    rows = [(str(n), f"{share:g}", *(f"{um:.1f}" for um in measured(n, share))) for n, share in CASES]
    heads = "passes", "tension of the last", "push from the wall, um", "error of the corner, um"
    print(table(heads, rows), end="\n\n", flush=True)
    by_passes()


if __name__ == "__main__":
    main()
