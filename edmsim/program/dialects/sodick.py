"""Sodick: conditions and offsets in tables at the head, both planes of a tapered cut in one block."""

from __future__ import annotations

from edmsim.program.dialects.dialect import TAPER, Dialect

SODICK = Dialect(
    "sodick",
    "Sodick machines",
    codes={
        **TAPER, ("G", 140): "two planes off", ("G", 141): "two planes left", ("G", 142): "two planes right",
        ("T", 90): "cut off", ("T", 91): "thread", ("M", 199): "end",
    },
    condition="C",
    columns=("ON", "OFF", "IP", "HRP", "MAO", "SV", "V", "SF", "C", "PIK", "CTRL", "WK", "WT", "WS", "WP"),
    angle="A",
    upper="colon",
    planes=True,
    ends_blocks=True,
    numbered=True,
    evidence=(
        (r"^C\d{3}=",), (r"H\d{3}(?!\d)", r"C\d{3}(?!\d)"), (r"G14[012](?!\d)",), (r"T[PN]=?[-+\d.]",),
        (r"M199(?!\d)",), (r"G5[12](?!\d)", r"A[\d.]", r"H\d{3}(?!\d)"),
    ),
)  # fmt: skip
