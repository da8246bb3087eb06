"""A picture of a part during its cut: drawing, kerf and error from above, results of passes, and the last step."""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.part_cut import PartCut
from edmsim.envs.part_task import PartEpisode
from edmsim.envs.render import HEIGHT, STRIP, canvas, draw_cut, pixels, strip
from edmsim.metrology.edges import cut_edges
from edmsim.metrology.profile import profile_error
from edmsim.recording.scene import ErrorMap, Polylines, Scene, holes_mm, polylines

BELOW = 120
"""Height of what is below the drawing: the passes, and the strip of the last step."""


def picture(episode: PartEpisode) -> NDArray[np.uint8]:
    """Return the picture of a part, uint8 (480, 640, 3)."""
    drawn = draw_cut(*_scene(episode.cut), HEIGHT - BELOW, (0.1, 0.14, 0.76, 0.76))
    return np.vstack([drawn, _passes(episode), _last_step(episode)])


def _scene(cut: PartCut) -> tuple[Scene, NDArray[np.float64]]:
    """Return what is drawn of the part, with its edges at mid height, and where the wire is."""
    contour, stock_mm = cut.path.contours[0], cut.path.stock_mm
    machine, simulation = cut.machine, cut.simulation
    place_mm, points, error = contour.points_um[0] * 1e-3, np.zeros((0, 2)), np.zeros(0)
    slices = 1 if simulation is None else simulation.plant.field.n_slices
    edges: list[Polylines] = [() for _ in range(slices)]
    radius = cut.path.start_hole_radius_mm
    holes = np.array([[*place_mm, radius]])
    if simulation is not None:
        plant = simulation.plant
        edges[slices // 2] = polylines(cut_edges(plant.field, slices // 2))
        place_mm = (np.array(plant.place_um) + plant.deflections_um().mean(axis=0)) * 1e-3
        holes = holes_mm(plant.field.stock)
        if cut.over:
            measured = profile_error(plant.field, contour)
            points, error = measured.points_mm, measured.mean_um
    scene = Scene(
        maps=(ErrorMap(contour.nominal_mm, contour.part_side, points, error),), cut_edges_mm=tuple(edges), corners=(),
        starts_mm=np.asarray(contour.points_um[:1] * 1e-3, np.float64), holes_mm=holes, stock_mm=stock_mm,
        height_mm=machine.height_mm, terraces=(), guides_z_mm=machine.guides_z_mm,
        wire_diameter_um=machine.wire_diameter_um, origin_mm=cut.path.origin_mm,
    )  # fmt: skip
    return scene, np.asarray(place_mm, np.float64)


def _passes(episode: PartEpisode) -> NDArray[np.uint8]:
    """Draw what every pass so far left beyond what it was to leave."""
    from edmsim.recording.figures.palette import BLUE, INK, MUTED

    cut, figure = episode.cut, canvas(BELOW - STRIP)
    walls = [cut.wall(number) for number in range(1, cut.passes + 1)]
    left = [math.nan if wall is None else wall.mean_um - cut.target_um(k) for k, wall in enumerate(walls, 1)]
    figure.text(0.02, 0.5, "metal left, less\nwhat is wanted, \u00b5m", fontsize=8, color=MUTED, va="center")
    axes = figure.add_axes((0.2, 0.3, 0.78, 0.62))
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    axes.bar(range(1, cut.passes + 1), np.nan_to_num(left), 0.25, color=BLUE)
    most = max([4.0, *(1.3 * abs(um) for um in left if math.isfinite(um))])
    axes.set_ylim(-most, most)
    axes.set_xlim(0.5, cut.passes + 0.5)
    axes.set_yticks([])
    axes.set_xticks(range(1, cut.passes + 1), [_named(k, um) for k, um in enumerate(left, 1)], fontsize=8, color=INK)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.tick_params(length=0, pad=1)
    return pixels(figure)


def _named(number: int, left_um: float) -> str:
    return f"pass {number}" + (f": {left_um:+.1f}".replace("-", "\u2212") if math.isfinite(left_um) else "")


def _last_step(episode: PartEpisode) -> NDArray[np.uint8]:
    """Draw what the last step did: pass, time, offset, reward, what became of the pulses."""
    sums, cut = episode.step.sums, episode.cut
    facts = [f"{cut.time_s:.0f} s"]
    if sums.pulses:
        facts += [f"pass {episode.number}: {episode.step.seconds:.0f} s", f"offset {cut.offset_um:.0f} \u00b5m"]
        facts += ["the wire broke"] if episode.step.broke else []
        facts += [f"error {episode.error_um:.2f} \u00b5m", f"Ra {episode.ra_um:.2f} \u00b5m"] if cut.over else []
        facts.append(f"reward {float(episode.terms.sum()):+.2f}")
    else:
        facts.append("no pulse yet")
    return strip(facts, {name: getattr(sums, name) for name in ("spark", "arc", "short", "open")})
