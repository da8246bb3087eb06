"""Part programs: G-code and DXF in, a wire path in whole micrometres out."""

from edmsim.program.load import load_program
from edmsim.program.path import CutPath, WireContour, plan_path

__all__ = ["CutPath", "WireContour", "load_program", "plan_path"]
