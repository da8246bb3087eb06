"""The gap for real controllers: boards of open machines on serial lines, samples of voltage and current, an FMU.

The connected controller sets the feed. `Rig` runs without a clock, for unit tests of firmware;
`edmsim.hil.session` connects it to pseudo-terminals in real time.
"""

from edmsim.hil.boards import BOARDS, Rig
from edmsim.hil.gap import Gap, delay_table
from edmsim.hil.samples import SampleReader, Sensing

__all__ = ["BOARDS", "Gap", "Rig", "SampleReader", "Sensing", "delay_table"]
