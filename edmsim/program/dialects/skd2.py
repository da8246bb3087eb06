"""SKD2, the control of fast-wire machines: offsets in um, conditions in a table at the head, a stop per pass."""

from __future__ import annotations

from edmsim.program.dialects.dialect import Dialect

SKD2 = Dialect(
    "skd2",
    "fast-wire machines with an SKD2",
    condition="E",
    columns=("W_SP", "I_MAX", "PUL_ON", "P_RATIO", "VOLTAGE", "AUXILIARY", "SPEED"),
    registers_in_um=True,
    ends_blocks=True,
    numbered=True,
    evidence=((r"^E\d{3}=",), (r"E\d{3}(?![\d=])", r"H\d{3}=\+?\d+(?![.\d])")),
)
