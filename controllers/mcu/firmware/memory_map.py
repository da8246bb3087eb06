"""Where the variables lie in RAM: names of the document where it has them, addresses of ours."""

from __future__ import annotations

# one area of variables for either stepper (row T-71), the same offsets in both
X_AREA, Y_AREA = 0x2000, 0x2010
AREAS = (X_AREA, Y_AREA)
POSITION, VELOCITY, TARGET, ROUNDS = 0, 2, 4, 6
"""Counter in um, signed speed in units, where the axis is to go, and rounds of its timer to be waited."""
XPOS, XVELOC, NEWX = (X_AREA + offset for offset in (POSITION, VELOCITY, TARGET))
YPOS, YVELOC, NEWY = (Y_AREA + offset for offset in (POSITION, VELOCITY, TARGET))
CUTVEL = 0x2020
"""Cutting speed in force, signed, in units."""
MAXVEL = 0x2022
"""Greatest cutting speed the operator allows, in units."""
SHORTS, OPENS = 0x2024, 0x2026
"""Counts read last."""
ENTRY = 0x2028
"""Number being entered at the keys."""
SAVED = 0x2030
"""Copy of both areas and the speed, made first thing in an emergency (row T-49)."""
SAVED_WORDS = (XPOS, XVELOC, YPOS, YVELOC, CUTVEL)
CIADR, COADR = 0x3FD0, 0x3FD2
"""Addresses of the routines that fetch and send characters (row T-58)."""

# addresses of routines in EPROM: what the jump table and the two words above point at
EMERGENCY_ROUTINE, X_ENTRY, Y_ENTRY, KBD_ROUTINE, NO_ROUTINE = 0x0200, 0x0210, 0x0218, 0x0220, 0x0228
TERMINAL_IN, HOST_IN, TERMINAL_OUT, HOST_OUT = 0x0100, 0x0108, 0x0110, 0x0118
