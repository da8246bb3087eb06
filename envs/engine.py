"""What runs an environment's episodes: lanes that step window by window, or parts that step pass by pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.batch import Batch
from edmsim.envs.lanes import Lanes
from edmsim.envs.part_picture import picture
from edmsim.envs.part_task import Part
from edmsim.envs.parts import Parts
from edmsim.envs.render import Renderer
from edmsim.envs.task import EnvArguments, Family
from edmsim.errors import InputError

Engine = Batch | Parts
"""Both have the same members, as far as Gymnasium's environments need them."""


def engine_of(family: EnvArguments, count: int, threads: int) -> Engine:
    """Return what runs so many episodes side by side."""
    if isinstance(family, Part):
        return Parts(family, count, threads)
    assert isinstance(family, Family)
    return Batch(family, count, threads)


def lanes_of(engine: Engine) -> Lanes:
    """Return the lanes that step window by window; raises `InputError` where there are none."""
    if isinstance(engine, Parts):
        raise InputError(
            "Part is decided on pass by pass: no feed controller can look on, and no recorder; edmsim cut --passes "
            "records the same part"
        )
    return engine.lanes


def picture_of(engine: Engine, renderer: Renderer, lane: int) -> NDArray[np.uint8]:
    """Return a lane's picture, uint8 (480, 640, 3)."""
    return picture(engine.lane(lane)) if isinstance(engine, Parts) else renderer.picture(engine, lane)
