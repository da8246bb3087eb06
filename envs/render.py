"""Pictures of environments: the machine by MuJoCo if there is a GL backend, else the cut as in ``profile.png``.

A strip below shows feed, shares of pulses and reward of the last step; for a part also the metal that passes left.
Recordings use the same geometry.
"""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.closed_loop.stops import StopCause
from edmsim.envs.part_task import PartCut, PartEpisode, Parts
from edmsim.envs.sub_envs import Batch, SubEnvs
from edmsim.geometry import Floats
from edmsim.metrology.edges import cut_edges
from edmsim.metrology.profile import corners, profile_error
from edmsim.plant.constants import wire_setup
from edmsim.plant.plant import Plant
from edmsim.recording.figures.palette import BLUE, INK, MUTED, SHARE_COLOURS, VERMILION
from edmsim.recording.scene import ErrorMap, Polylines, Scene, holes_mm, polylines, terraces

Picture = NDArray[np.uint8]  # (height, width, 3)
HEIGHT, WIDTH = 480, 640
STRIP = 64  # height of the strip at the bottom, included in `HEIGHT`
DPI = 80
BELOW = 120
"""Height of the area below the drawing of a part: the passes, and the strip of the last step."""
SHOWN_DIAMETERS = 12  # width of the view of a longer cut, in wire diameters
_SWITCHED_OFF = ("disable", "disabled", "off", "0", "false")
"""Values of MUJOCO_GL that switch MuJoCo's drawing off."""


def has_gl() -> bool:
    """Whether MuJoCo can draw: off screen by MUJOCO_GL, or on a display."""
    if os.environ.get("MUJOCO_GL", "").lower() in ("egl", "osmesa"):
        return True
    headless = sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )
    return not headless and os.environ.get("MUJOCO_GL", "").lower() not in _SWITCHED_OFF


class Renderer:
    """Draws sub-environments, and shows the pictures in a window."""

    def __init__(self) -> None:
        self._gl: Any = None  # MuJoCo's renderer, and the set-up that it draws
        self._of: Any = None
        self._shown: Any = None
        self._drawn_only = False

    def picture(self, engine: Batch | Parts, index: int) -> Picture:
        """Return a sub-environment's picture (480, 640, 3): the machine by MuJoCo if it can draw, else the cut."""
        from edmsim.recording.figures.style import own_style

        with own_style():
            if isinstance(engine, Parts):
                return _of_part(engine.episode(index))
            return np.vstack([self._view(engine.sub_envs, index), _step(engine, index)])

    def _view(self, sub_envs: SubEnvs, index: int) -> Picture:
        if not self._drawn_only and has_gl():
            try:
                return self._machine(sub_envs.fleet.plants[index])
            except Exception:  # a GL backend that does not work may raise any error
                self._drawn_only = True
        return _drawing(sub_envs, index)

    def _machine(self, plant: Plant) -> Picture:
        import mujoco

        from edmsim.plant.mechanics.model import build_model

        setup = wire_setup(plant.machine)
        if self._gl is None or self._of != setup:
            self._close_gl()
            self._gl = mujoco.Renderer(build_model(setup, plant.machine.base.model), HEIGHT - STRIP, WIDTH)
            self._of = setup
        model = self._gl.model
        data = mujoco.MjData(model)
        for axis, place_um in zip("xy", plant.place_um, strict=True):
            data.qpos[model.joint(axis).qposadr[0]] = place_um * 1e-6
        mujoco.mj_forward(model, data)
        self._gl.update_scene(data, camera="overview")
        return np.asarray(self._gl.render(), np.uint8)

    def show(self, picture: Picture) -> None:
        """Show a picture in a window; do nothing if there is no display."""
        from matplotlib import pyplot

        if pyplot.get_backend().lower() == "agg":
            return
        if self._shown is None:
            figure, axes = pyplot.subplots(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI, num="edmsim")
            axes.set_position((0, 0, 1, 1))
            axes.set_axis_off()
            self._shown = axes.imshow(picture)
            pyplot.show(block=False)
        self._shown.set_data(picture)
        figure = self._shown.figure
        figure.canvas.draw_idle()
        figure.canvas.flush_events()

    def close(self) -> None:
        """Close the window and the GL context."""
        self._close_gl()
        if self._shown is not None:
            from matplotlib import pyplot

            pyplot.close(self._shown.figure)
            self._shown = None

    def _close_gl(self) -> None:
        if self._gl is not None:
            self._gl.close()
            self._gl = None

    def __getstate__(self) -> dict[str, Any]:
        """Return nothing: a copy opens windows and contexts of its own."""
        return {}

    def __setstate__(self, _: dict[str, Any]) -> None:
        """Begin with nothing open."""
        Renderer.__init__(self)


def path_scene(sub_envs: SubEnvs, index: int) -> Scene:
    """Return a scene that is quick to make, for a picture at every step: the wire's path, and edges at mid height."""
    scenario, plant = sub_envs.scenario(index), sub_envs.fleet.plants[index]
    machine, none = scenario.machine, np.zeros((0, 2))
    x0, y0, x1, y1 = (v * 1e-3 for v in scenario.stock.rectangle_um)
    edges: list[Polylines] = [() for _ in range(plant.resolution.slices)]
    scene = Scene(
        maps=tuple(ErrorMap(leg * 1e-3, "left", none, none[:, 0]) for leg in scenario.legs_um),
        cut_edges_mm=tuple(edges), corners=(),
        starts_mm=np.array([leg[0] * 1e-3 for leg in scenario.legs_um]), holes_mm=holes_mm(scenario.stock),
        stock_mm=(x0, y0, x1, y1), height_mm=machine.height_mm,
        terraces=terraces(plant.field.relief, (x0, y0, x1, y1)),
        guides_z_mm=machine.guides_z_mm, wire_diameter_um=machine.wire_diameter_um,
    )  # fmt: skip
    shown = scene.middle_slice()
    edges[shown] = polylines(cut_edges(plant.field, shown))
    return replace(scene, cut_edges_mm=tuple(edges))


def scene_of(sub_envs: SubEnvs, index: int) -> Scene:
    """Return the measured scene: edges of every slice, and of a program also the drawing with the errors."""
    scene = path_scene(sub_envs, index)
    scenario, plant = sub_envs.scenario(index), sub_envs.fleet.plants[index]
    field, (x_um, y_um) = plant.field, plant.commanded_um
    measured = [(contour, profile_error(field, contour)) for contour in scenario.contours]
    finished = sub_envs.rows[index]["cause"] == StopCause.FINISHED
    return replace(
        scene,
        maps=tuple(ErrorMap(k.nominal_mm, k.part_side, p.points_mm, p.mean_um) for k, p in measured) or scene.maps,
        corners=tuple(corner for k, p in measured for corner in corners(k, p)),
        cut_edges_mm=tuple(polylines(cut_edges(field, s)) for s in range(field.n_slices)),
        stop_mm=None if finished else (x_um * 1e-3, y_um * 1e-3),
    )


def _drawing(sub_envs: SubEnvs, index: int) -> Picture:
    """Draw the cut edges of a sub-environment's workpiece, its path and its wire."""
    scene, place_mm = path_scene(sub_envs, index), _wire_mm(sub_envs.fleet.plants[index])
    # a sub-environment has no drawing, so the path of its wire is drawn as nominal edge
    return _draw_cut(
        scene, place_mm, HEIGHT - STRIP, (0.12, 0.13, 0.84, 0.77), _around(place_mm, scene),
        {"nominal edge": "path of the wire"},
    )  # fmt: skip


def _wire_mm(plant: Plant) -> Floats:
    """Return the position of the wire, with its deflection averaged over the height."""
    return np.asarray((np.array(plant.place_um) + plant.deflections_um().mean(axis=0)) * 1e-3, np.float64)


def _around(place_mm: Floats, scene: Scene) -> tuple[float, float, float, float]:
    """Return the limits of the view: the whole cut, or near the wire if the cut is so long that it would be a dot."""
    x0, y0, x1, y1 = scene.extent_mm()
    half_mm = SHOWN_DIAMETERS * scene.wire_diameter_um * 0.5e-3
    if max(x1 - x0, y1 - y0) <= 2 * half_mm:
        return x0, y0, x1, y1
    x, y = place_mm.tolist()
    return max(x0, x - half_mm), max(y0, y - half_mm), min(x1, x + half_mm), min(y1, y + half_mm)


def _draw_cut(
    scene: Scene, place_mm: Floats, height: int, box: tuple[float, float, float, float],
    view: tuple[float, float, float, float] | None = None, names: Mapping[str, str] | None = None,
) -> Picture:
    """Draw a cut from above with its wire; `names` replaces names in the legend."""
    from matplotlib.patches import Circle

    from edmsim.recording.figures.profile import draw_map

    figure, (x, y) = _canvas(height), place_mm - (scene.origin_mm or (0.0, 0.0))
    axes = figure.add_subplot(position=box)
    draw_map(axes, scene, view)
    axes.add_patch(Circle((float(x), float(y)), scene.wire_diameter_um * 0.5e-3, color=VERMILION, zorder=9))
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        [*handles, *axes.plot([], [], "o", color=VERMILION)],
        [*((names or {}).get(label, label) for label in labels), "wire"], loc="lower left", bbox_to_anchor=(0.0, 1.0),
        ncols=6, frameon=False, fontsize=8, handlelength=1.6, columnspacing=1.2, borderpad=0.0, borderaxespad=0.3,
        labelcolor=INK,
    )  # fmt: skip
    return _pixels(figure)


def _strip(facts: Sequence[str], counts: Mapping[str, int]) -> Picture:
    """Draw facts of a step, and below them a bar with its pulses by class."""
    figure = _canvas(STRIP)
    figure.text(0.02, 0.68, "   ".join(facts).replace("-", "−"), fontsize=9, color=INK, va="center")
    axes = figure.add_axes((0.02, 0.14, 0.96, 0.24))
    axes.set_axis_off()
    axes.set_xlim(0, max(sum(counts.values()), 1))
    left = 0
    for name, count in counts.items():
        axes.barh(0.0, count, left=left, color=SHARE_COLOURS[name])
        left += count
    return _pixels(figure)


def _canvas(height: int) -> Any:
    """Return an empty figure as wide as a picture."""
    from edmsim.recording.figures.style import NotebookFigure

    return NotebookFigure(figsize=(WIDTH / DPI, height / DPI), dpi=DPI, facecolor="white")


def _pixels(figure: Any) -> Picture:
    """Return the pixels of a figure of `_canvas`."""
    figure.canvas.draw()
    return np.array(figure.canvas.buffer_rgba())[..., :3].copy()


def _step(batch: Batch, index: int) -> Picture:
    """Draw the last step of a sub-environment: machine time, feed, pulses by class, reward."""
    info = batch.infos()
    counts = {name: int(info[name][index]) for name in SHARE_COLOURS}
    facts = [f"{float(info['time_s'][index]):.2f} s", f"feed {float(info['feed_um_s'][index]):.1f} µm/s"]
    if sum(counts.values()):
        facts += [f"{name} {count}" for name, count in counts.items()]
        facts.append(f"reward {float(batch.account.rows['total'][index]):+.3f}")
    else:
        facts.append("no pulse yet")
    return _strip(facts, counts)


def _of_part(episode: PartEpisode) -> Picture:
    drawn = _draw_cut(*_part_scene(episode.cut), HEIGHT - BELOW, (0.1, 0.14, 0.76, 0.76))
    return np.vstack([drawn, _passes(episode), _last_step(episode)])


def _part_scene(cut: PartCut) -> tuple[Scene, Floats]:
    """Return the scene of a part with its edges at mid height, and the wire's position."""
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
        place_mm = _wire_mm(plant)
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


def _passes(episode: PartEpisode) -> Picture:
    """Draw the metal that every pass so far left, less its target."""
    cut, figure = episode.cut, _canvas(BELOW - STRIP)
    walls = [cut.wall(number) for number in range(1, cut.passes + 1)]
    left = [np.nan if wall is None else wall.mean_um - cut.target_um(k) for k, wall in enumerate(walls, 1)]
    figure.text(0.02, 0.5, "metal left, minus\nits target, \u00b5m", fontsize=8, color=MUTED, va="center")
    axes = figure.add_axes((0.2, 0.3, 0.78, 0.62))
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    axes.bar(range(1, cut.passes + 1), np.nan_to_num(left), 0.25, color=BLUE)
    most = max([4.0, *(1.3 * abs(um) for um in left if np.isfinite(um))])
    axes.set_ylim(-most, most)
    axes.set_xlim(0.5, cut.passes + 0.5)
    axes.set_yticks([])
    axes.set_xticks(range(1, cut.passes + 1), [_named(k, um) for k, um in enumerate(left, 1)], fontsize=8, color=INK)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.tick_params(length=0, pad=1)
    return _pixels(figure)


def _named(number: int, left_um: float) -> str:
    return f"pass {number}" + (f": {left_um:+.1f}".replace("-", "\u2212") if np.isfinite(left_um) else "")


def _last_step(episode: PartEpisode) -> Picture:
    """Draw the last step of a part: pass, time, offset, reward, pulses by class."""
    sums, cut = episode.step.sums, episode.cut
    facts = [f"{cut.time_s:.0f} s"]
    if sums.pulses:
        facts += [f"pass {episode.number}: {episode.step.seconds:.0f} s", f"offset {cut.offset_um:.0f} \u00b5m"]
        facts += ["the wire broke"] if episode.step.broke else []
        facts += [f"error {episode.error_um:.2f} \u00b5m", f"Ra {episode.ra_um:.2f} \u00b5m"] if cut.over else []
        facts.append(f"reward {sum(episode.terms.values()):+.2f}")
    else:
        facts.append("no pulse yet")
    return _strip(facts, {name: getattr(sums, name) for name in ("spark", "arc", "short", "open")})
