"""The UHU Servo Controller 3.00."""

from edmsim.controllers.axis.uhu.drive import Uhu

__all__ = ["Uhu"]
