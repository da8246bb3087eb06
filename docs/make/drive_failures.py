"""The tables of `docs/servo-drives.md` and `docs/positioner.md`: outcomes of cuts in which a drive or axis fails.

python docs/make/drive_failures.py
"""

import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from sections import table, write_sections

import edmsim
from edmsim.errors import BAD_INPUT, InputError

PAGES = {"uhu": "servo-drives.md", "servo-module": "servo-drives.md", "eanpos": "positioner.md"}
LINE = "G21 G90\nG1 X0.4 Y0.3\nM2\n"
SQUARES = """G21 G90
G0 X-0.4 Y0.1
G41
G1 X0 Y0.1
Y0.2
X0.2
Y0
X0
Y0.1
G40
G0 X1.6 Y0.1
G41
G1 X2 Y0.1
Y0.2
X2.2
Y0
X2
Y0.1
G40
M2
"""
"""Two squares 2 mm apart."""
STOPPED = 3
"""Exit status of a cut that did not finish."""


class Failure(NamedTuple):
    """A failure: its name, the drive and axis fault for ``edmsim cut``, and the program."""

    name: str
    drive: str
    fault: str = ""
    program: str = LINE

    @property
    def typed(self) -> str:
        """Options of the command line."""
        return f"--drive {self.drive}" + (f" --axis-fault {self.fault}" if self.fault else "")


_SETTINGS = {
    "uhu": {
        "a motor that gets nothing": "T=0", "wrong scale": "M=4",
        "runs away": "P=1000,I=25,D=255,H=1000,X=3000,T=255,N=100", "swings": "P=900,D=255,H=0",
    },
    "servo-module": {
        "a motor that gets nothing": "C=0", "wrong scale": "X=4", "runs away": "P=3000,D=0",
        "swings": "E=40000,P=2000,D=1000",
    },
    "eanpos": {
        "speed of 0": "setvel=0", "target out of its limits": "maxpos=10", "wrong scale": "measure=800",
        "swings": "pgain=3000",
    },
}  # fmt: skip
_FAULTS = {
    "wrong sign": "swapped@0", "stuck": "stuck@0.5", "encoder unplugged": "unplugged@0.5",
    "power of the motor lost": "supply-off@0.5", "power of the logic lost": "logic-off@0.5",
    "fault line": "fault-line@0.5", "drive hangs": "stalled@0.5",
}  # fmt: skip
_SLOW = {"uhu": "uhu:X=10", "eanpos": "eanpos:setvel=40"}


def failures(drive: str) -> list[Failure]:
    """Return the failures of a drive."""
    found = [Failure(name, f"{drive}:{changes}") for name, changes in _SETTINGS[drive].items()]
    found += [Failure(name, drive, f"x:{fault}") for name, fault in _FAULTS.items()]
    if drive in _SLOW:
        found.append(Failure("slow rapid, two squares", _SLOW[drive], program=SQUARES))
    return [*found, Failure("none", drive)]


def row(failure: Failure) -> tuple[str, ...]:
    """Cut with a failure, and return the cells of its row."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "part.ngc"
        program.write_text(failure.program, encoding="utf-8")
        faults = (failure.fault,) if failure.fault else ()
        try:
            report = edmsim.cut(
                program, height_mm=3, resolution="fast", drive=failure.drive, axis_faults=faults
            ).report
        except InputError as error:
            outcome, status, reason = "refused", BAD_INPUT, error.reason
        else:
            outcome, reason = report["outcome"], report["reason"] or ""
            status = 0 if outcome == "finished" else STOPPED
    return failure.name, f"`{failure.typed}`", f"{outcome}, {status}", reason


if __name__ == "__main__":
    heads = "what fails", "typed", "outcome, status", "reason"
    for drive, page in PAGES.items():
        print(drive, file=sys.stderr)
        write_sections(page, {f"failures {drive}": table(heads, map(row, failures(drive)))})
