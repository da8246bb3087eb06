"""Part programs: G-code and DXF in, a wire path in whole micrometres out."""

from edmsim.program.path import Contour, CutPath, load_program, plan_path

__all__ = ["Contour", "CutPath", "load_program", "plan_path"]
