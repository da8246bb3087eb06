"""MuJoCo's models of a machine's table, alone and with the wire, made ready to be stepped by compiled code."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim.errors import EdmsimError
from edmsim.plant.mechanics import mjcf
from edmsim.plant.mechanics.model import (
    MODEL_FILE,
    ModalModel,
    WireSetup,
    at_heights,
    check_allowed,
    machine_spec,
    reduce_model,
)
from edmsim.plant.mechanics.mujoco_axes import FullLink

if TYPE_CHECKING:
    import mujoco

Array = NDArray[np.float64]

_ALLOWED: dict[str, tuple[float, float, str]] = {
    "step_m": (1e-8, 1e-3, "m (0.01 um to 1 mm)"),
    "friction_N": (0.0, 1e3, "N"),
    "presliding_m": (1e-7, 1e-4, "m (0.1 to 100 um)"),
    "backlash_m": (0.0, 1e-3, "m (0 to 1 mm)"),
}


@dataclass(frozen=True)
class DriveSetup:
    """What the drives of the table have that its linear model has not."""

    step_m: float  # travel of one full step of a motor, in m
    friction_N: float  # Coulomb friction of an axis' ways in N; 0 for none
    presliding_m: float  # travel in m over which friction builds up to 63 % after a reversal
    backlash_m: float  # play of a nut on its screw in m; 0 for a preloaded one

    def __post_init__(self) -> None:
        check_allowed(self, "drive", _ALLOWED)


class TableMechanics:
    """MuJoCo's model and data of a table; keep it as long as the link, which holds addresses of its memory."""

    def __init__(self, drive: DriveSetup, longest_us: float, model_file: str = MODEL_FILE) -> None:
        spec = mjcf.read(model_file).copy()
        for part in (list(spec.tendons), list(spec.bodies)):
            for item in part:
                if item.name.partition("_")[0] in ("wire", "segment"):
                    spec.delete(item)
        for item in (*spec.lights, *spec.cameras, *spec.sites):
            spec.delete(item)
        self.model = compile_without_geoms(spec)
        self._make_ready(drive)
        self.link = self._link_of_table(drive, longest_us)

    def _make_ready(self, drive: DriveSetup) -> None:
        import mujoco

        _free_motors(self.model, drive)
        self.data = mujoco.MjData(self.model)

    def _link_of_table(self, drive: DriveSetup, longest_us: float) -> FullLink:
        """Return the link of a model without a wire."""
        model, data = self.model, self.data
        motors = [model.actuator(f"{axis}_stepper") for axis in "xy"]
        teeth = float(model.numeric("rotor_teeth").data[0])
        return FullLink(
            mj_step=_address_of_step(),
            model=model._address,
            data=data._address,
            timestep=_timestep(model),
            qpos=data.qpos,
            qvel=data.qvel,
            force=data.qfrc_applied,
            wire=np.zeros((2, 0), np.int64),
            carriage=dofs_of(model, ["x", "y"]),
            rotor=dofs_of(model, ["x_rotor", "y_rotor"]),
            longest_us=longest_us,
            reach_m=math.inf,
            node_kg=np.zeros(0),
            most_force_N=math.inf,
            rad_per_um=np.array([1 / screw["um_per_rad"] for screw in mjcf.screw_constants(model)]),
            step_um=drive.step_m * 1e6,
            holding_Nm=np.array([motor.gainprm[0] / teeth for motor in motors]),
            teeth=teeth,
            friction_N=drive.friction_N,
            presliding_m=drive.presliding_m,
            friction_share=np.zeros(2),
        )

    def set_travel(self, travel_m: float) -> None:
        """Put the far stops of both axes as far behind a travel as the near ones stand before zero."""
        for axis in "xy":
            stops = self.model.joint(axis).range
            stops[1] = travel_m - stops[0]

    @property
    def stops_um(self) -> tuple[float, float]:
        """End stops of an axis, the near one below zero and the far one beyond the travel."""
        near_m, far_m = self.model.joint("x").range
        return near_m * 1e6, far_m * 1e6

    def set_motor(self, axis: int, motor: NDArray[np.void]) -> None:
        """Put a direct-current motor, a row of `MOTOR`, in the place of the stepper of x (0) or y (1)."""
        name = "xy"[axis]
        self.model.dof_damping[self.link.rotor[axis]] = motor["damping_Nm_s"][0]
        self.model.body(f"{name}_rotor").inertia[:] = motor["inertia_kg_m2"][0]
        tendon, play_m = self.model.tendon(f"{name}_screw").id, motor["backlash_um"][0] * 1e-6
        self.model.tendon_lengthspring[tendon] = -play_m / 2, play_m / 2
        self.model.tendon_damping[tendon] = 0.0  # the loop has the damper, which does nothing within the backlash

    def reset(self) -> None:
        """Let the ways' friction go; positions and velocities come from the plant's arrays."""
        self.link.friction_share[:] = 0.0

    def snapshot(self) -> dict[str, Array]:
        """Return what changes and is not in the plant's arrays; with them, `restore` continues bit for bit."""
        return {"friction_share": self.link.friction_share.copy()}

    def restore(self, state: dict[str, Array]) -> None:
        """Take back a `snapshot`."""
        self.link.friction_share[:] = state["friction_share"]


def compile_without_geoms(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model without its geoms: they are drawn only, and yet a time step would pay for them."""
    for geom in list(spec.geoms):
        spec.delete(geom)
    return cast("mujoco.MjModel", spec.compile())


def _free_motors(model: mujoco.MjModel, drive: DriveSetup) -> None:
    """Take the linear motors off, give the nuts their play, and leave the integration to plain Euler steps."""
    import mujoco

    for axis in "xy":
        model.tendon_lengthspring[model.tendon(f"{axis}_screw").id] = -drive.backlash_m / 2, drive.backlash_m / 2
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # explicit damping costs least; without warm start only positions, velocities and forces go into a step
    off = mujoco.mjtDisableBit
    for flag in (off.mjDSBL_ACTUATION, off.mjDSBL_EULERDAMP, off.mjDSBL_WARMSTART, off.mjDSBL_AUTORESET):
        model.opt.disableflags |= flag


def dofs_of(model: mujoco.MjModel, joints: list[str]) -> NDArray[np.int64]:
    """Degrees of freedom of slides and hinges; they stand at the same place in qpos and in qvel."""
    return np.array([int(model.joint(name).dofadr[0]) for name in joints], np.int64)


def _address_of_step() -> int:
    """Return where ``mj_step`` is; looked up through the bindings, so it is the library they have loaded."""
    import mujoco

    function = ctypes.CDLL(mujoco._functions.__file__).mj_step
    return cast("int", ctypes.cast(function, ctypes.c_void_p).value)


def _timestep(model: mujoco.MjModel) -> Array:
    """Return a view of the model's time step, which the bindings give as a copy only."""
    # gravity, of which there is a view, stands a few numbers behind it. A place counts if it follows two changes
    gravity = model.opt.gravity.__array_interface__["data"][0]
    before = model.opt.timestep
    for back in range(1, 17):
        place = np.ctypeslib.as_array((ctypes.c_double * 1).from_address(gravity - 8 * back))
        follows = []
        for value in (1.2345678e-5, 7.6543210e-6):
            model.opt.timestep = value
            follows.append(place[0] == value)
        if all(follows):
            model.opt.timestep = before
            return place
    raise EdmsimError("MuJoCo's time step is not where this version of edmsim looks for it")


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
    """Return the longest time step in s at which no mode grows."""
    # semi-implicit Euler with explicit damping c = 2 zeta omega is stable up to ``omega^2 dt^2 + 2 c dt = 4``
    omega = np.concatenate([modes.wire_omega, modes.table_omega.ravel()])
    damping = 2 * np.concatenate([modes.wire_zeta, modes.table_zeta.ravel()]) * omega
    return float(np.min((np.sqrt(damping**2 + 4 * omega**2) - damping) / omega**2))
