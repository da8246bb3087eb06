"""The dialects of G-code: a record for each, and how the dialect of a program is recognised."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from edmsim.errors import refuse_unknown

Action = Literal[
    "thread", "cut off", "adaptive", "constant", "end", "idle", "no taper", "taper left", "taper right", "conical",
    "cylindrical", "two planes off", "two planes left", "two planes right",
]
"""Effect of a code. "idle": no effect on a contour, as of tank, water and wire on and off."""

Codes = Mapping[tuple[str, float], Action]
TAPER: Codes = {("G", 50): "no taper", ("G", 51): "taper left", ("G", 52): "taper right"}


@dataclass(frozen=True)
class Dialect:
    """A dialect: words and their meaning."""

    name: str  # value of ``--dialect``
    machines: str  # machines that use it, for notices
    # codes that only this dialect has, or that have a special meaning in it, and their effects; others have their
    # usual meaning or none
    codes: Codes = field(default_factory=dict)
    condition: str = ""  # letter that calls a machining condition; empty if there is none
    # columns of its table of conditions, in their usual order; empty if programs contain no table
    columns: tuple[str, ...] = ()
    angle: str = ""  # letter of a taper's angle in degrees; empty if there is none
    signed_angle: bool = False  # whether the sign of the angle sets the side, without G51 or G52
    # how the second plane is written: U V relative to X Y, U V as coordinates, or a move after a colon
    upper: Literal["relative", "absolute", "colon"] | None = None
    planes: bool = False  # whether TP and TN set the heights of the two planes
    registers_in_um: bool = False  # whether ``H001=100`` is in um, whatever the unit of coordinates is
    ends_blocks: bool = False  # whether ``;`` ends a block, so that another may follow on the line
    dwells_in_ms: bool = False  # whether the P of G4 is in ms, and its X without a decimal point
    routines: frozenset[str] = frozenset()  # names as in ``QAIC(...)``, without effect on a contour
    numbered: bool = False  # whether subprograms begin at N numbers as well as at O numbers
    # the dialect is recognised if all regular expressions of one of these tuples are found in the program, in upper
    # case, without comments and blanks
    evidence: tuple[tuple[str, ...], ...] = ()
    comment: str = ""  # regular expression that recognises its comments; empty if there is none

    @property
    def letters(self) -> str:
        """Letters whose numbers are used, in addition to those of all dialects."""
        return self.angle + {"relative": "UVK", "absolute": "UV"}.get(self.upper or "", "")

    def found_in(self, words: str, comments: str) -> str | None:
        """Return the text by which a program (upper case, no comments or blanks) is recognised; None if it is not."""
        for alternative in self.evidence:
            found = [re.search(pattern, words, re.MULTILINE) for pattern in alternative]
            if all(found):
                return " and ".join(match[0] for match in found if match)
        remark = re.search(self.comment, comments, re.IGNORECASE) if self.comment else None
        return f"the comment '{remark[0]}'" if remark else None


ISO = Dialect("iso", "any machine")
"""The words common to all controls, for programs in which no other dialect is recognised."""


# Charmilles Robofil: offsets and settings by number from the control's tables, G28 and G29 for tapered corners.

CHARMILLES = Dialect(
    "charmilles",
    "Charmilles Robofil machines",
    codes={**TAPER, ("G", 28): "conical", ("G", 29): "cylindrical", ("M", 20): "thread", ("M", 21): "cut off"},
    condition="S",
    angle="A",
    evidence=((r"(?<!G91)G2[89](?![\dXYZ])",),),  # elsewhere return to the reference point, with its axes
)  # fmt: skip


# Fanuc: D calls the offset, S the condition, T is a taper's angle; U V and K L are the upper plane's.

FANUC = Dialect(
    "fanuc",
    "machines with a Fanuc control",
    codes={**TAPER, ("M", 60): "thread", ("M", 50): "cut off"},
    condition="S",
    angle="T",
    upper="relative",
    dwells_in_ms=True,
    evidence=(
        (r"G5[12](?!\d).*?T[\d.]+",), (r"[UV][-+\d.]+.*?[KL][-+\d.]+",), (r"[KL][-+\d.]+.*?[UV][-+\d.]+",),
        (r"S0*1(?!\d)", r"S0*2(?!\d)", r"D0*1(?![\d=])", r"D0*2(?![\d=])"),
    ),
)


# FreeCAD's post processor for wire EDM: any line end, comments after any sign, coordinates in any scale.

FREECAD = Dialect("freecad", "FreeCAD's wire post", comment=r"FreeCAD|begin preamble")
_COORDINATE = re.compile(r"[XYIJ][-+]?[\d.]", re.IGNORECASE)
_LINE_END = re.compile(r"(?<![^\d.\s()])[^\d.\s()]++$")
_MARKS = r"[^\w\s%/();#\[]"
# possessive: every blank and mark is matched once, because a line of only blanks would otherwise take hours
_MARKED_COMMENT = re.compile(rf"(?<!\s)(?:\s++|(?=N)|(?<!{_MARKS}))(?:N\d++)?+\s*+{_MARKS}++\s*+(?=\()")
INCHES = re.compile(r"\(machine:[^)]*\bin/min\)", re.IGNORECASE)


def without_line_ends(lines: Sequence[str]) -> list[str]:
    """Remove the sign at the end of all lines with coordinates, and signs before comments."""
    # a sign that some lines lack is not a line end, nor is a single letter, because they may be incomplete words
    bare = [re.sub(r"\([^()]*\)", "", line.partition(";")[0]).rstrip() for line in lines]
    ends = [_LINE_END.search(line) for line in bare if _COORDINATE.search(line)]
    found = {end and end[0] for end in ends}
    end = found.pop() if len(found) == 1 and len(ends) > 1 else None
    cut = lines if end is None or re.fullmatch("[A-Za-z]", end) else [
        line.rstrip()[: -len(end)] if line.rstrip().endswith(end) else line for line in lines
    ]  # fmt: skip
    return [_MARKED_COMMENT.sub("", line) for line in cut]


# LinuxCNC with four axes, as on hot-wire foam cutters: U V are coordinates of the upper plane.

LINUXCNC = Dialect(
    "linuxcnc",
    "LinuxCNC with four axes",
    upper="absolute",
    evidence=((r"[UV][-+\d.]+", r"G64(?!\d)"),),
    comment=r"linuxcnc|foam|hot.?wire|\b(?:UV|XY).?plane",
)

_PLANE = re.compile(r"\b(XY|UV)[ -]?PLANE\D*?([-+]?(?:\d+\.?\d*|\.\d+))", re.IGNORECASE)


def plane_heights(comments: Iterable[str]) -> dict[str, float]:
    """Return the heights of planes stated in comments, as ``(UV plane Z20)``, by ``XY`` and ``UV``, as written."""
    return {found[1].upper(): float(found[2]) for text in comments for found in _PLANE.finditer(text)}


# Mitsubishi FA: offsets as sums of registers, a condition number per pass, M codes for tank, water and power.

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
    dwells_in_ms=True,
    evidence=((r"H\d{1,4}=[-+\d.]*\+H\d{1,4}",), (r"E\d{3,4}(?![\d=])", r"M(?:2[01]|58|78|8[0-9]|9[01])(?!\d)")),
)  # fmt: skip


# SKD2, the control of fast-wire machines: offsets in um, conditions in a table at the head, a stop per pass.

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


# Sodick: conditions and offsets in tables at the head, both planes of a tapered cut in one block.

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
    routines=frozenset({"QAIC"}),
    ends_blocks=True,
    numbered=True,
    evidence=(
        (r"^C\d{3}=",), (r"H\d{3}(?!\d)", r"C\d{3}(?!\d)"), (r"G14[012](?!\d)",), (r"T[PN]=?[-+\d.]",),
        (r"M199(?!\d)",), (r"QAIC",), (r"G5[12](?!\d)", r"A[\d.]", r"(?<![-+])H\d{3}(?![\d=])"),
    ),
)  # fmt: skip

DIALECTS = {
    dialect.name: dialect for dialect in (SODICK, MITSUBISHI, SKD2, CHARMILLES, FANUC, LINUXCNC, FREECAD, ISO)
}  # fmt: skip
"""Dialects by name, in the order in which programs are tested for them."""
AUTO = "auto"
_COMMENT = re.compile(r"\(([^()]*)\)|;(.*)")


def comments_of(text: str) -> list[str]:
    """Return the comments of a program."""
    return ["".join(found) for found in _COMMENT.findall(text)]


def dialect_of(text: str, requested: str) -> tuple[Dialect, list[str]]:
    """Return the dialect of a program, and notices about it; ``auto`` recognises it by words that no other has."""
    refuse_unknown("dialect", requested, (AUTO, *DIALECTS))
    if requested != AUTO:
        return DIALECTS[requested], [f"dialect {requested} ({DIALECTS[requested].machines}), as requested"]
    words = "\n".join("".join(_COMMENT.sub("", line).split()) for line in text.upper().splitlines())
    comments = "\n".join(comments_of(text))
    for dialect in DIALECTS.values():
        found = dialect.found_in(words, comments)
        if found is not None and (dialect is not LINUXCNC or re.search(r"[UV][-+\d.]", words)):
            short = found if len(found) < 60 else f"{found[:57]}..."
            return dialect, [f"dialect {dialect.name} ({dialect.machines}), recognised by {' '.join(short.split())}; "
                             "--dialect selects another"]  # fmt: skip
    return ISO, []
