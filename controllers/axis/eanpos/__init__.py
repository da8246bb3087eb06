"""QEM EANPOS, an analogue positioner."""

from edmsim.controllers.axis.eanpos.drive import Eanpos

__all__ = ["Eanpos"]
