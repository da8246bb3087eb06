"""Pictures of an environment: its machine by MuJoCo where there is a GL backend, else the cut as in ``profile.png``.

Below either, a strip says what the last step did: feed, shares of pulses, reward.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import refuse_unknown

if TYPE_CHECKING:
    import mujoco
    from matplotlib.figure import Figure

    from edmsim.envs.sub_envs import Batch, SubEnvs
    from edmsim.plant.plant import Plant
    from edmsim.recording.scene import Scene

RENDER_MODES = ("rgb_array", "human")
RENDER_FPS = 39  # pictures per second at the machine's own pace: a window of the standard setting takes 25.5 ms
HEIGHT, WIDTH = 480, 640
STRIP = 64  # height of the strip below, part of the picture's
SHOWN_DIAMETERS = 12  # wire diameters across what is drawn of a longer cut
DPI = 80
_SWITCHED_OFF = ("disable", "disabled", "off", "0", "false")
"""What MuJoCo takes MUJOCO_GL to mean when nothing is to be drawn."""


def check_render_mode(mode: str | None) -> str | None:
    """Raise `InputError` for a render mode there is not."""
    if mode is not None:
        refuse_unknown("render_mode", mode, RENDER_MODES)
    return mode


def has_gl() -> bool:
    """Whether MuJoCo has a way to draw: MUJOCO_GL off screen, or a display."""
    if os.environ.get("MUJOCO_GL", "").lower() in ("egl", "osmesa"):
        return True
    headless = sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )
    return not headless and os.environ.get("MUJOCO_GL", "").lower() not in _SWITCHED_OFF


class Renderer:
    """Draws sub-environments, and shows what it drew; made cheaply, it loads nothing before the first picture."""

    def __init__(self) -> None:
        self._gl: mujoco.Renderer | None = None
        self._shown: Any = None
        self._of: Any = None
        self._drawn_only = False

    def picture(self, batch: Batch, index: int) -> NDArray[np.uint8]:
        """Return a sub-environment's picture, uint8 (480, 640, 3)."""
        return np.vstack([self._view(batch.sub_envs, index), _strip(batch, index)])

    def _view(self, sub_envs: SubEnvs, index: int) -> NDArray[np.uint8]:
        if not self._drawn_only and has_gl():
            try:
                return self._machine(sub_envs.fleet.plants[index])
            except Exception:  # what a GL backend raises that is there in name only is nobody's to foresee
                self._drawn_only = True
        return _drawing(sub_envs, index)

    def _machine(self, plant: Plant) -> NDArray[np.uint8]:
        import mujoco

        from edmsim.plant.constants import wire_setup
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

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture in a window; where there is no display, nothing can be shown and nothing fails."""
        import matplotlib

        if matplotlib.get_backend().lower() == "agg":
            return
        from matplotlib import pyplot

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
        """Let window and GL context go."""
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


def _drawing(sub_envs: SubEnvs, index: int) -> NDArray[np.uint8]:
    """Draw what was cut of a sub-environment's workpiece, its path and its wire."""
    from edmsim.envs.scene import path_scene

    scene, plant = path_scene(sub_envs, index), sub_envs.fleet.plants[index]
    place = (np.array(plant.place_um) + plant.deflections_um().mean(axis=0)) * 1e-3
    # what a sub-environment has of a drawing is the path of its wire
    return draw_cut(
        scene, place, HEIGHT - STRIP, (0.12, 0.13, 0.84, 0.77), _around(place, scene),
        {"nominal edge": "path of the wire"},
    )  # fmt: skip


def draw_cut(
    scene: Scene, place_mm: NDArray[np.float64], height: int, box: tuple[float, float, float, float],
    view: tuple[float, float, float, float] | None = None, names: Mapping[str, str] | None = None,
) -> NDArray[np.uint8]:
    """Draw a cut from above with its wire, and its parts by other names where `names` has some."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    from edmsim.recording.figures.palette import INK, VERMILION
    from edmsim.recording.figures.profile import draw_map

    figure, (x, y) = canvas(height), place_mm - (scene.origin_mm or (0.0, 0.0))
    axes = figure.add_subplot(position=box)
    draw_map(axes, scene, view)
    axes.add_patch(Circle((float(x), float(y)), scene.wire_diameter_um * 0.5e-3, color=VERMILION, zorder=9))
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        [*handles, Line2D([], [], marker="o", linestyle="", color=VERMILION)],
        [*((names or {}).get(label, label) for label in labels), "wire"], loc="lower left", bbox_to_anchor=(0.0, 1.0),
        ncols=6, frameon=False, fontsize=8, handlelength=1.6, columnspacing=1.2, borderpad=0.0, borderaxespad=0.3,
        labelcolor=INK,
    )  # fmt: skip
    return pixels(figure)


def _around(place_mm: NDArray[np.float64], scene: Scene) -> tuple[float, float, float, float]:
    """Return what of a cut is drawn: all of it, or what is near the wire, which would be a dot in a long one."""
    x0, y0, x1, y1 = scene.extent_mm()
    half_mm = SHOWN_DIAMETERS * scene.wire_diameter_um * 0.5e-3
    if max(x1 - x0, y1 - y0) <= 2 * half_mm:
        return x0, y0, x1, y1
    x, y = place_mm.tolist()
    return max(x0, x - half_mm), max(y0, y - half_mm), min(x1, x + half_mm), min(y1, y + half_mm)


def _strip(batch: Batch, index: int) -> NDArray[np.uint8]:
    """Draw what a sub-environment's last step did: feed, what became of the pulses, reward, machine time."""
    from edmsim.recording.figures.palette import SHARE_COLOURS

    info = batch.infos()
    counts = {name: int(info[name][index]) for name in SHARE_COLOURS}
    pulses = sum(counts.values())
    facts = [f"{float(info['time_s'][index]):.2f} s", f"feed {float(info['feed_um_s'][index]):.1f} µm/s"]
    if pulses:
        facts += [f"{name} {count}" for name, count in counts.items()]
        facts.append(f"reward {float(batch.account.total[index]):+.3f}")
    else:
        facts.append("no pulse yet")
    return strip(facts, counts)


def strip(facts: Sequence[str], counts: Mapping[str, int]) -> NDArray[np.uint8]:
    """Draw facts of a step, and below them what became of its pulses."""
    from edmsim.recording.figures.palette import INK, SHARE_COLOURS

    figure = canvas(STRIP)
    figure.text(0.02, 0.68, "   ".join(facts).replace("-", "−"), fontsize=9, color=INK, va="center")
    axes = figure.add_axes((0.02, 0.14, 0.96, 0.24))
    axes.set_axis_off()
    axes.set_xlim(0, max(sum(counts.values()), 1))
    left = 0
    for name, count in counts.items():
        axes.barh(0.0, count, left=left, color=SHARE_COLOURS[name])
        left += count
    return pixels(figure)


def canvas(height: int) -> Figure:
    """Return an empty figure as wide as a picture, with an Agg canvas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH / DPI, height / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def pixels(figure: Figure) -> NDArray[np.uint8]:
    """Return what is drawn on a figure of `canvas`."""
    drawn: Any = figure.canvas
    drawn.draw()
    return np.array(drawn.buffer_rgba())[..., :3].copy()
