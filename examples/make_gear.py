"""Draw ``gear.dxf``: 12 teeth of module 0.5 mm with involute flanks, and a round bore.

Run ``python examples/make_gear.py`` to write it again next to this script.
"""

import math
from pathlib import Path

import ezdxf
import numpy as np
from ezdxf.math import global_bspline_interpolation
from numpy.typing import NDArray

TEETH = 12
MODULE_MM = 0.5
PRESSURE_ANGLE = math.radians(20)
BORE_RADIUS_MM = 1.2

PITCH_RADIUS = TEETH * MODULE_MM / 2
BASE_RADIUS = PITCH_RADIUS * math.cos(PRESSURE_ANGLE)
TIP_RADIUS = PITCH_RADIUS + MODULE_MM
ROOT_RADIUS = PITCH_RADIUS - 1.25 * MODULE_MM
BACKLASH_ANGLE = 0.02


def flank_angle(radius: float) -> float:
    """Return half the angle (rad) of a tooth at a radius in mm, by the involute of the base circle."""
    def involute(angle: float) -> float:
        return math.tan(angle) - angle

    at_pitch = (math.pi / TEETH - BACKLASH_ANGLE) / 2
    pressure = math.acos(min(BASE_RADIUS / radius, 1.0))
    return at_pitch + involute(PRESSURE_ANGLE) - involute(pressure)


def polar(radius: float, angle: float) -> tuple[float, float]:
    """Return a point in mm."""
    return radius * math.cos(angle), radius * math.sin(angle)


def flank(centre_angle: float, side: int) -> list[tuple[float, float]]:
    """Return points of a flank from the base circle to the tip; side +1 or -1 of the tooth's middle."""
    radii: NDArray[np.float64] = np.linspace(BASE_RADIUS, TIP_RADIUS, 9)
    return [polar(radius, centre_angle + side * flank_angle(radius)) for radius in radii.tolist()]


def main() -> None:
    """Write the drawing."""
    drawing = ezdxf.new("R2000")
    drawing.units = ezdxf.units.MM
    space = drawing.modelspace()
    pitch = math.tau / TEETH
    for tooth in range(TEETH):
        middle = tooth * pitch
        for side in (-1, 1):
            spline = space.add_spline()
            spline.apply_construction_tool(global_bspline_interpolation(flank(middle, side)))
            angle = middle + side * flank_angle(BASE_RADIUS)
            space.add_line(polar(ROOT_RADIUS, angle), polar(BASE_RADIUS, angle))
        half_tip, half_base = flank_angle(TIP_RADIUS), flank_angle(BASE_RADIUS)
        tip = [math.degrees(middle + side * half_tip) for side in (-1, 1)]
        root = [math.degrees(middle + half_base), math.degrees(middle + pitch - half_base)]
        space.add_arc((0, 0), TIP_RADIUS, *tip)
        space.add_arc((0, 0), ROOT_RADIUS, *root)
    space.add_circle((0, 0), BORE_RADIUS_MM)
    drawing.saveas(Path(__file__).with_name("gear.dxf"))


if __name__ == "__main__":
    main()
