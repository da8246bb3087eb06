"""Mitsubishi FA: offsets as sums of registers, a condition number per pass, M codes for tank, water and power."""

from __future__ import annotations

from edmsim.program.dialects.dialect import TAPER, Dialect

MITSUBISHI = Dialect(
    "mitsubishi",
    "Mitsubishi machines of the series FA",
    codes={
        **TAPER,
        ("M", 20): "thread", ("M", 21): "cut off", ("M", 58): "idle", ("M", 90): "adaptive", ("M", 91): "constant",
    },
    condition="E",
    angle="A",
    signed_angle=True,
    upper="relative",
    evidence=((r"H\d{1,4}=[-+\d.]*\+H\d{1,4}",), (r"E\d{3,4}(?![\d=])", r"M(?:2[01]|58|78|8[0-9]|9[01])(?!\d)")),
)  # fmt: skip
