"""The gap for real controllers: boards of open machines on serial lines, samples of voltage and current, an FMU.

Nothing here decides about the feed: the connected controller does. `Rig` runs without a clock, for a firmware's
unit tests; `edmsim.hil.session` puts it behind pseudo-terminals in real time.
"""

from edmsim.hil.delays import delay_table
from edmsim.hil.gap import Gap
from edmsim.hil.rig import BOARDS, Rig
from edmsim.hil.samples import SampleReader, Sensing

__all__ = ["BOARDS", "Gap", "Rig", "SampleReader", "Sensing", "delay_table"]
