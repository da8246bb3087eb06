"""The servo processor module, revision A."""

from edmsim.controllers.axis.servo_module.drive import ServoModule

__all__ = ["ServoModule"]
