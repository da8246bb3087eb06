"""Draw ``square_to_round.dxf``: a punch with a square lower contour with round corners and a round upper contour.

Run ``python examples/make_square_to_round.py`` to write it again next to this script.
"""

import math
from pathlib import Path
from typing import Any

import ezdxf

SIDE_MM, CORNER_MM, RADIUS_MM = 4.0, 0.8, 1.8
"""Of the lower contour: sides and corners; of the upper one: radius."""


def turned(x: float, y: float, quarters: int) -> tuple[float, float]:
    """Return a point turned by quarters of a turn."""
    for _ in range(quarters):
        x, y = -y, x
    return x, y


def square(space: Any) -> None:
    """Draw four sides and four corners, counter-clockwise from the lower side on."""
    half, inner, layer = SIDE_MM / 2, SIDE_MM / 2 - CORNER_MM, {"layer": "LOWER"}
    for quarters in range(4):
        ends = turned(-inner, -half, quarters), turned(inner, -half, quarters)
        space.add_line(*ends, dxfattribs=layer)
        centre = turned(inner, -inner, quarters)
        space.add_arc(centre, CORNER_MM, 90 * quarters - 90, 90 * quarters, dxfattribs=layer)


def circle(space: Any) -> None:
    """Draw a circle of eight arcs, one for each side and corner of the square."""
    of_side = 2 * math.degrees(math.atan((SIDE_MM / 2 - CORNER_MM) / (SIDE_MM / 2)))
    for quarters in range(4):
        start, end = 90 * quarters - 90 - of_side / 2, 90 * quarters - 90 + of_side / 2
        for a, b in ((start, end), (end, start + 90)):
            space.add_arc((0.0, 0.0), RADIUS_MM, a, b, dxfattribs={"layer": "UPPER"})


def main() -> None:
    """Write the drawing next to this script."""
    document = ezdxf.new("R2010")
    document.units = 4  # mm
    for name in ("LOWER", "UPPER"):
        document.layers.add(name)
    square(document.modelspace())
    circle(document.modelspace())
    document.saveas(Path(__file__).with_name("square_to_round.dxf"))


if __name__ == "__main__":
    main()
