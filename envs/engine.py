"""What runs an environment's episodes: lanes that step window by window, or parts that step pass by pass.

Parts are loaded where they are made: what cuts programs takes longer to load than lanes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.batch import Batch
from edmsim.envs.lanes import Lanes
from edmsim.envs.render import Renderer
from edmsim.envs.task import EnvArguments, Family
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.envs.parts import Parts

    Engine = Batch | Parts  # both have the members that Gymnasium's environments need


def engine_of(family: EnvArguments, count: int, threads: int) -> Engine:
    """Return what runs `count` episodes side by side."""
    if isinstance(family, Family):
        return Batch(family, count, threads)
    from edmsim.envs.part_task import Part
    from edmsim.envs.parts import Parts

    assert isinstance(family, Part)
    return Parts(family, count, threads)


def lanes_of(engine: Engine) -> Lanes:
    """Return the lanes that step window by window; raises `InputError` where there are none."""
    if isinstance(engine, Batch):
        return engine.lanes
    raise InputError(
        "Part is decided on pass by pass: no feed controller can look on, and no recorder; edmsim cut --passes "
        "records the same part"
    )


def picture_of(engine: Engine, renderer: Renderer, lane: int) -> NDArray[np.uint8]:
    """Return a lane's picture, uint8 (480, 640, 3)."""
    if isinstance(engine, Batch):
        return renderer.picture(engine, lane)
    from edmsim.envs.part_picture import picture

    return picture(engine.lane(lane))
