"""Part programs: G-code and DXF in, a wire path in whole micrometres out."""

from edmsim.program.path import CutPath, WireContour, load_program, plan_path

__all__ = ["CutPath", "WireContour", "load_program", "plan_path"]
