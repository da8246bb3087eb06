"""Fanuc: D calls the offset, S the condition, T is a taper's angle; U V and K L are the upper plane's."""

from __future__ import annotations

from edmsim.program.dialects.dialect import TAPER, Dialect

FANUC = Dialect(
    "fanuc",
    "machines with a Fanuc control",
    codes={**TAPER, ("M", 60): "thread", ("M", 50): "cut off"},
    condition="S",
    angle="T",
    upper="relative",
    evidence=(
        (r"G5[12](?!\d).*?T[\d.]+",), (r"[UV][-+\d.]+.*?[KL][-+\d.]+",), (r"[KL][-+\d.]+.*?[UV][-+\d.]+",),
        (r"S0*1(?!\d)", r"S0*2(?!\d)", r"D0*1(?![\d=])", r"D0*2(?![\d=])"),
    ),
)
