"""Charmilles Robofil: offsets and settings by number from the control's tables, G28 and G29 for tapered corners."""

from __future__ import annotations

from edmsim.program.dialects.dialect import TAPER, Dialect

CHARMILLES = Dialect(
    "charmilles",
    "Charmilles Robofil machines",
    codes={**TAPER, ("G", 28): "conical", ("G", 29): "cylindrical", ("M", 20): "thread", ("M", 21): "cut off"},
    condition="S",
    angle="A",
    evidence=((r"G2[89](?!\d)",),),
)  # fmt: skip
