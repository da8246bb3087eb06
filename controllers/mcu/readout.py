"""What the program shows on the 32 digits: position, speed, and the counts of the last 255 pulses in percent.

The display was not connected in 1982 (4.3); which digit shows what is ours. Figures are all it can
show, no sign or point.
"""

from __future__ import annotations

from typing import NamedTuple

from edmsim.analyser import WINDOW_PULSES
from edmsim.controllers.mcu.display import BLANK, Kdc8279, write_digit


class Field(NamedTuple):
    """Some digits beside each other: the first of them, how many, and what they show."""

    first: int
    width: int
    name: str


FIELDS = (
    Field(0, 5, "X um"), Field(6, 5, "Y um"), Field(13, 3, "SPEED"),
    Field(16, 3, "SHORT %"), Field(20, 3, "OPEN %"), Field(24, 3, "t(i) us"), Field(28, 4, "t(p) us"),
)  # fmt: skip
"""Bank A is digits 0 to 15, bank B 16 to 31."""


def show(
    display: Kdc8279, position: tuple[int, int], speed: int, short: int, open: int, times_us: tuple[float, float]
) -> None:
    """Write every field: whole numbers, without zeros before them.

    Parameters
    ----------
    display : Kdc8279
    position : (int, int)
    speed : int
        In units; its magnitude is shown.
    short, open : int
        Counts of 255 pulses.
    times_us : (float, float)
        t(i) and t(p).
    """
    shares = (round(100 * count / WINDOW_PULSES) for count in (short, open))
    values = (*position, abs(speed), *shares, *(round(us) for us in times_us))
    for field, value in zip(FIELDS, values, strict=True):
        for place, figure in enumerate(str(value).rjust(field.width)[-field.width :]):
            write_digit(display, field.first + place, BLANK if figure == " " else int(figure))
