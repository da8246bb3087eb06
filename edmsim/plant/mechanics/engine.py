"""MuJoCo. It cannot be imported where MUJOCO_GL names drawing software that this computer lacks."""

import os

from edmsim.errors import InputError

__all__ = ["mujoco"]

try:
    import mujoco
except (AttributeError, OSError, RuntimeError):  # of PyOpenGL without its library, and of MuJoCo for an unknown name
    if not (name := os.environ.get("MUJOCO_GL")):
        raise
    raise InputError(
        f"MuJoCo cannot be loaded with MUJOCO_GL={name}: unset this variable, or set MUJOCO_GL=disable; only "
        "pictures of environments use it"
    ) from None
