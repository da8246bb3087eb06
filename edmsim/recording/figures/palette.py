"""Colours of figures and recordings: distinct with every common colour blindness, and in grey."""

import numpy as np
from numpy.typing import NDArray

INK = "#1f2933"
MUTED = "#6b7785"
LINE = "#d9dde2"
GRID = "#e3e7eb"
METAL = "#f3f1ec"
# From the palette of Okabe and Ito (2008), https://jfly.uni-koeln.de/color/.
BLUE = "#0072b2"
ORANGE = "#e69f00"
GREEN = "#009e73"
VERMILION = "#d55e00"
PURPLE = "#cc79a7"
SKY = "#56b4e9"
YELLOW = "#f0e442"
# Ours: pale, so that bubbles of gas differ from sparks.
GAS = "#cfe8f4"
SHARE_COLOURS = {"spark": BLUE, "arc": PURPLE, "short": VERMILION, "open": "#c9d1d9"}
"""Colours of the classes of pulses, in stacking order."""

CLASS_COLOURS = {"spark": SKY, "open": MUTED, "short": VERMILION, "arc": PURPLE}
"""Colours of the classes in a recording, whose background is dark."""
PASS_COLOURS = INK, BLUE, SKY, GREEN, ORANGE, VERMILION, PURPLE  # by pass, the rough pass first

ERROR_STOPS = ("#00467f", "#3f8fc4", "#a3abb3", "#e58a3c", "#a83200")
"""Colours of the profile error: too much removed (blue), none (grey), metal left (orange)."""


def pass_colour(number: int) -> str:
    """Return the colour of a pass, by its number from 1."""
    return PASS_COLOURS[(number - 1) % len(PASS_COLOURS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green, blue (0..255) of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def error_rgb(error_um: NDArray[np.float64], limit_um: float) -> NDArray[np.uint8]:
    """Return the colours (n, 3) of profile errors, clamped to +-`limit_um`."""
    stops = np.array([rgb(stop) for stop in ERROR_STOPS], float)
    place = np.linspace(-limit_um, limit_um, len(stops))
    return (np.column_stack([np.interp(error_um, place, stops[:, k]) for k in range(3)]).round().astype(np.uint8))
