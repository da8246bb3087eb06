"""Rendering of environments: the machine by MuJoCo where there is a GL backend, and a window for ``"human"``."""

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import refuse_unknown
from edmsim.plant.constants import wire_setup
from edmsim.plant.plant import Plant

RENDER_MODES = ("rgb_array", "human")
RENDER_FPS = 39  # pictures per second at the machine's own pace: a window of the standard setting takes 25.5 ms
HEIGHT, WIDTH = 480, 640
STRIP = 64  # height of the strip below, part of the picture's
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
    """Draws machines, and shows pictures; made cheaply, it loads nothing before the first one."""

    def __init__(self) -> None:
        self._gl: Any = None  # MuJoCo's renderer, and the set-up that it draws
        self._shown: Any = None
        self._of: Any = None
        self._drawn_only = False

    def machine(self, plant: Plant) -> NDArray[np.uint8] | None:
        """Return MuJoCo's picture of a machine, `STRIP` lower than a whole one; None where it cannot draw."""
        if not self._drawn_only and has_gl():
            try:
                return self._by_mujoco(plant)
            except Exception:  # what a GL backend raises that is there in name only is nobody's to foresee
                self._drawn_only = True
        return None

    def _by_mujoco(self, plant: Plant) -> NDArray[np.uint8]:
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
