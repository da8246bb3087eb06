r"""QCL, the language of QEM's QMOVE controls: the configurations and programs of the EANPOS manual.

>>> from edmsim.controllers.qcl import Control, read_configuration, read_program
>>> plant = read_configuration("GLOBAL\ncount L\nEND")
>>> control = Control(plant, read_program("count = 10 * 99999 / 100\nEND", plant))
>>> control.run_pass()
>>> control.variables["count"]
9999
"""

from __future__ import annotations

from edmsim.controllers.qcl.configuration import Configuration, Declaration, read_configuration
from edmsim.controllers.qcl.control import Control
from edmsim.controllers.qcl.program import QclProgram, read_program
from edmsim.controllers.qcl.text import Problem, QclError

__all__ = [
    "Configuration",
    "Control",
    "Declaration",
    "Problem",
    "QclError",
    "QclProgram",
    "read_configuration",
    "read_program",
]  # fmt: skip
