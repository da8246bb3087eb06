"""The geometry that pictures of an environment draw: its path or drawing, and the remaining metal."""

from dataclasses import replace

import numpy as np

from edmsim.cosim.stops import StopCause
from edmsim.envs.sub_envs import SubEnvs
from edmsim.metrology.edges import cut_edges
from edmsim.metrology.profile import corners, profile_error
from edmsim.recording.scene import ErrorMap, Polylines, Scene, holes_mm, polylines, terraces


def path_scene(sub_envs: SubEnvs, index: int) -> Scene:
    """Return a cut quickly, for a picture at every step: the wire's path, and the edges at mid height."""
    scenario, plant = sub_envs.scenario(index), sub_envs.fleet.plants[index]
    machine, none = scenario.machine, np.zeros((0, 2))
    x0, y0, x1, y1 = (v * 1e-3 for v in scenario.stock.rectangle_um)
    edges: list[Polylines] = [() for _ in range(plant.resolution.slices)]
    scene = Scene(
        maps=tuple(ErrorMap(leg * 1e-3, "left", none, none[:, 0]) for leg in scenario.legs_um),
        cut_edges_mm=tuple(edges), corners=(),
        starts_mm=np.array([leg[0] * 1e-3 for leg in scenario.legs_um]), holes_mm=holes_mm(scenario.stock),
        stock_mm=(x0, y0, x1, y1), height_mm=machine.height_mm,
        terraces=terraces(plant.field.relief, (x0, y0, x1, y1)),
        guides_z_mm=machine.guides_z_mm, wire_diameter_um=machine.wire_diameter_um,
    )  # fmt: skip
    shown = scene.middle_slice()
    edges[shown] = polylines(cut_edges(plant.field, shown))
    return replace(scene, cut_edges_mm=tuple(edges))


def scene_of(sub_envs: SubEnvs, index: int) -> Scene:
    """Return a cut, measured: every slice's edges, and where a program is cut its drawing with the errors."""
    scene = path_scene(sub_envs, index)
    scenario, plant = sub_envs.scenario(index), sub_envs.fleet.plants[index]
    field, (x_um, y_um) = plant.field, plant.commanded_um
    measured = [(contour, profile_error(field, contour)) for contour in scenario.contours]
    finished = sub_envs.rows[index]["cause"] == StopCause.FINISHED
    return replace(
        scene,
        maps=tuple(ErrorMap(k.nominal_mm, k.part_side, p.points_mm, p.mean_um) for k, p in measured) or scene.maps,
        corners=tuple(corner for k, p in measured for corner in corners(k, p)),
        cut_edges_mm=tuple(polylines(cut_edges(field, s)) for s in range(field.n_slices)),
        stop_mm=None if finished else (x_um * 1e-3, y_um * 1e-3),
    )
