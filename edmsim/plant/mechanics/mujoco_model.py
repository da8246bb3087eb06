"""The full MuJoCo model of table and wire, made ready to be stepped by the compiled pulse loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from edmsim.plant.mechanics.model import MODEL_FILE, ModalModel, WireSetup, at_heights, machine_spec, reduce_model
from edmsim.plant.mechanics.mujoco_axes import FullLink
from edmsim.plant.mechanics.mujoco_table import DriveSetup, TableMechanics, compile_without_geoms, dofs_of

N_NODES = 25
"""Nodes of the wire, the fewest whose first four modes are within 1 % of the string's: a time step costs what
its nodes cost, and fewer nodes allow a longer one."""
_STEP_SHARE, _VARIED_STEP_SHARE = 0.95, 0.7
"""Longest time step as a share of the longest stable one. Near the limit the errors of chain and time step cancel: at
the limit itself waves run along the chain as along the string. Where it changes from pulse to pulse it stays further
off (ours), as each change feeds the chain's highest mode, the more the nearer to the limit."""
_MOST_ACCELERATION = 5e9  # m/s2; MuJoCo takes 1e10 for a number gone wild


class FullMechanics(TableMechanics):
    """MuJoCo's model and data for one plant; keep it as long as the link, which holds addresses of its memory."""

    def __init__(
        self, wire: WireSetup, drive: DriveSetup, slice_heights_m: ArrayLike, model_file: str = MODEL_FILE,
        *, varied: bool = False,
    ) -> None:
        self.model = compile_without_geoms(machine_spec(wire, model_file, N_NODES))
        self.modes = reduce_model(self.model, N_NODES, slice_heights_m)
        self._make_ready(drive)
        heights = np.asarray(slice_heights_m, float)
        nodes = at_heights(np.eye(N_NODES), self.modes.node_heights_m, wire.guide_distance_m, heights)
        self.wire_shape = np.ascontiguousarray(nodes)
        self._node_mass = np.array([self.model.body(f"wire_{i:02d}").mass[0] for i in range(N_NODES)])
        self.mobility = nodes.sum(axis=0) / self._node_mass
        self.inertia = nodes.mean(axis=0)
        self.slice_mass_kg = 1 / (nodes**2 / self._node_mass).sum(axis=1)
        self.table_slide_shape = np.array([[1.0, 0.0], [1.0, 0.0]])
        self.table_participation = np.zeros((2, 2))
        self.link = self._link_with_wire(wire, drive, _VARIED_STEP_SHARE if varied else _STEP_SHARE)

    def _link_with_wire(self, wire: WireSetup, drive: DriveSetup, share: float) -> FullLink:
        wildest = _MOST_ACCELERATION / float(self.modes.wire_omega[-1]) ** 2
        return self._link_of_table(drive, share * _stable_step(self.modes) * 1e6)._replace(
            wire=np.array([dofs_of(self.model, [f"wire_{axis}{i:02d}" for i in range(N_NODES)]) for axis in "xy"]),
            reach_m=min(wire.guide_distance_m / 2, wildest),
            node_kg=self._node_mass,
            most_force_N=_MOST_ACCELERATION * float(self.model.body("wire_00").mass[0]),
        )


def _stable_step(modes: ModalModel) -> float:
    """Return the longest time step in s at which no mode grows.

    Semi-implicit Euler with explicit damping c = 2 zeta omega is stable up to ``omega^2 dt^2 + 2 c dt = 4``.
    """
    omega = np.concatenate([modes.wire_omega, modes.table_omega.ravel()])
    damping = 2 * np.concatenate([modes.wire_zeta, modes.table_zeta.ravel()]) * omega
    return float(np.min((np.sqrt(damping**2 + 4 * omega**2) - damping) / omega**2))
