"""The full model: MuJoCo models of the table, with or without the wire, stepped by compiled code.

A pulse is a few calls of ``mj_step``. Here a plant's modal arrays hold coordinates of the full model, so the other
code that moves the wire works unchanged: ``wire_q`` and ``wire_v`` are deflections of the wire's nodes in um and
um/s, ``shape`` interpolates linearly between nodes, and ``table_q[axis]`` holds the positions of carriage and rotor
relative to the commanded one, in um of travel, ``table_v[axis]`` their speeds in um/s. The bench of the drives steps
the table alone.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.memory_views import call_with_two
from edmsim.errors import EdmsimError
from edmsim.plant.axes.advance import LOST, advance_axes
from edmsim.plant.axes.encoder import position, see_edges, watch_cam
from edmsim.plant.axes.feed_drive import energise, rotor_after_friction, screw_damping, table_after_friction
from edmsim.plant.kernel.state import CHANGING, Array, Arrays, Axes, Constants, Propagators, Stored, Timing
from edmsim.plant.mechanics import model as mechanics
from edmsim.plant.mechanics.squeeze_film import film_now, suction_limited

if TYPE_CHECKING:
    import mujoco

class FullLink(NamedTuple):
    """A MuJoCo model for compiled code: addresses, views into MuJoCo's memory, and constants."""

    # valid as long as its model and data exist; `FullMechanics` holds them
    # addresses of ``mj_step`` and its two arguments
    mj_step: int
    model: int
    data: int
    timestep: Annotated[Array, Stored(1)]  # (1,): the model's time step in s
    # (degrees of freedom,): positions, velocities and applied forces, SI
    qpos: Annotated[Array, Stored("dofs")]
    qvel: Annotated[Array, Stored("dofs")]
    force: Annotated[Array, Stored("dofs")]
    # (2, nodes): degrees of freedom of every node in x and y, from the lower guide up
    wire: Annotated[NDArray[np.int64], Stored(2, "nodes")]
    # (2,): degrees of freedom of the axes' carriages and rotors
    carriage: Annotated[NDArray[np.int64], Stored(2)]
    rotor: Annotated[NDArray[np.int64], Stored(2)]
    longest_us: float  # longest time step
    reach_m: float  # greatest valid distance of a node from the line between the guides
    node_kg: Annotated[Array, Stored("nodes")]  # (nodes,): mass of every node
    most_force_N: float  # greatest valid force on a node
    rad_per_um: Annotated[Array, Stored(2)]  # (2,): rotor angle per um of travel
    step_um: float  # travel of a full step of a motor
    holding_Nm: Annotated[Array, Stored(2)]  # (2,): largest torque of a motor
    teeth: float  # periods of this torque per turn
    friction_N: float  # Coulomb friction of an axis' ways
    presliding_m: float  # travel over which friction builds up
    # (2,): friction on each axis as a share of `friction_N`, -1 to 1: the only state besides the plant's arrays
    friction_share: Annotated[Array, Stored(2, life=CHANGING)]


_ALLOWED: dict[str, tuple[float, float, str]] = {
    "step_m": (1e-8, 1e-3, "m (0.01 um to 1 mm)"),
    "friction_N": (0.0, 1e3, "N"),
    "presliding_m": (1e-7, 1e-4, "m (0.1 to 100 um)"),
    "backlash_m": (0.0, 1e-3, "m (0 to 1 mm)"),
}


@dataclass(frozen=True)
class DriveSetup:
    """Constants of the table's drives that its linear model does not have."""

    step_m: float  # travel of one full step of a motor, in m
    friction_N: float  # Coulomb friction of an axis' ways in N; 0 for none
    presliding_m: float  # travel in m over which friction builds up to 63 % after a reversal
    backlash_m: float  # backlash of a nut on its screw in m; 0 for a preloaded one

    def __post_init__(self) -> None:
        mechanics.check_allowed(self, "drive", _ALLOWED)


class TableMechanics:
    """MuJoCo's model and data of a table. It must exist as long as its link, which has addresses of its memory."""

    def __init__(self, drive: DriveSetup, longest_us: float, model_file: str = mechanics.MODEL_FILE) -> None:
        spec = mechanics.read_mjcf(model_file).copy()
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
        """Disable the linear motors, set the backlash of the nuts, and use plain Euler steps."""
        from edmsim.plant.mechanics.engine import mujoco

        model = self.model
        for axis in "xy":
            model.tendon_lengthspring[model.tendon(f"{axis}_screw").id] = -drive.backlash_m / 2, drive.backlash_m / 2
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        # explicit damping is fastest; without warm start a step depends only on positions, velocities and forces
        off = mujoco.mjtDisableBit
        for flag in (off.mjDSBL_ACTUATION, off.mjDSBL_EULERDAMP, off.mjDSBL_WARMSTART, off.mjDSBL_AUTORESET):
            model.opt.disableflags |= flag
        self.data = mujoco.MjData(model)

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
            rad_per_um=np.array([1 / screw["um_per_rad"] for screw in mechanics.screw_constants(model)]),
            step_um=drive.step_m * 1e6,
            holding_Nm=np.array([motor.gainprm[0] / teeth for motor in motors]),
            teeth=teeth,
            friction_N=drive.friction_N,
            presliding_m=drive.presliding_m,
            friction_share=np.zeros(2),
        )

    def set_travel(self, travel_m: float) -> None:
        """Place the far stops of both axes as far beyond a travel as the near ones are before zero."""
        for axis in "xy":
            stops = self.model.joint(axis).range
            stops[1] = travel_m - stops[0]

    @property
    def stops_um(self) -> tuple[float, float]:
        """Positions of an axis' end stops: the near one below zero, the far one beyond the travel."""
        near_m, far_m = self.model.joint("x").range
        return near_m * 1e6, far_m * 1e6

    def set_motor(self, axis: int, motor: NDArray[np.void]) -> None:
        """Replace the stepper of x (0) or y (1) by a DC motor, a record of `MOTOR`."""
        name = "xy"[axis]
        self.model.dof_damping[self.link.rotor[axis]] = motor["damping_Nm_s"][0]
        self.model.body(f"{name}_rotor").inertia[:] = motor["inertia_kg_m2"][0]
        tendon, play_m = self.model.tendon(f"{name}_screw").id, motor["backlash_um"][0] * 1e-6
        self.model.tendon_lengthspring[tendon] = -play_m / 2, play_m / 2
        self.model.tendon_damping[tendon] = 0.0  # the loop computes this damping, which is 0 within the backlash

    def reset(self) -> None:
        """Release the friction of the ways; positions and velocities come from the plant's arrays."""
        self.link.friction_share[:] = 0.0

    def snapshot(self) -> dict[str, Array]:
        """Return the state that is not in the plant's arrays; together they continue bit for bit."""
        return {"friction_share": self.link.friction_share.copy()}

    def restore(self, state: dict[str, Array]) -> None:
        """Load a `snapshot`."""
        self.link.friction_share[:] = state["friction_share"]


def compile_without_geoms(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model without its geoms, which are only drawn but would take time in every step."""
    for geom in list(spec.geoms):
        spec.delete(geom)
    return cast("mujoco.MjModel", spec.compile())


def dofs_of(model: mujoco.MjModel, joints: list[str]) -> NDArray[np.int64]:
    """Return the degrees of freedom of slide and hinge joints, whose indices are the same in qpos and qvel."""
    return np.array([int(model.joint(name).dofadr[0]) for name in joints], np.int64)


def _address_of_step() -> int:
    """Return the address of ``mj_step`` in the library that the Python bindings have loaded."""
    from edmsim.plant.mechanics.engine import mujoco

    function = ctypes.CDLL(mujoco._functions.__file__).mj_step
    return cast("int", ctypes.cast(function, ctypes.c_void_p).value)


def _timestep(model: mujoco.MjModel) -> Array:
    """Return a view of the model's time step, of which the bindings only return copies."""
    # gravity, of which there is a view, is a few numbers after it; the right place follows two changes of the step
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


_STEP_SHARE, _VARIED_STEP_SHARE = 0.95, 0.7
"""Longest time step as a share of the longest stable one, for a constant and for a varying period. Near the limit the
errors of chain and time step cancel: at the limit waves on the chain are exactly as fast as on the string. If the
step varies from pulse to pulse, its share is smaller (ours), because every change excites the chain's highest mode,
the more the nearer the step is to the limit."""
_MOST_ACCELERATION = 5e9  # m/s2; MuJoCo treats 1e10 as divergence


class FullMechanics(TableMechanics):
    """MuJoCo's model and data for one plant. It must exist as long as its link, which has addresses of its memory."""

    def __init__(
        self, wire: mechanics.WireSetup, drive: DriveSetup, slice_heights_m: ArrayLike,
        model_file: str = mechanics.MODEL_FILE, *, varied: bool = False,
    ) -> None:
        count = mechanics.N_NODES
        self.model = compile_without_geoms(mechanics.machine_spec(wire, model_file, count))
        self.modes = mechanics.reduce_model(self.model, count, slice_heights_m)
        self._make_ready(drive)
        heights = np.asarray(slice_heights_m, float)
        nodes = mechanics.at_heights(np.eye(count), self.modes.node_heights_m, wire.guide_distance_m, heights)
        self.wire_shape = np.ascontiguousarray(nodes)
        self._node_mass = np.array([self.model.body(f"wire_{i:02d}").mass[0] for i in range(count)])
        self.mobility = nodes.sum(axis=0) / self._node_mass
        self.inertia = nodes.mean(axis=0)
        self.slice_mass_kg = 1 / (nodes**2 / self._node_mass).sum(axis=1)
        self.table_slide_shape = np.array([[1.0, 0.0], [1.0, 0.0]])
        self.table_participation = np.zeros((2, 2))
        self.link = self._link_with_wire(wire, drive, _VARIED_STEP_SHARE if varied else _STEP_SHARE)

    def _link_with_wire(self, wire: mechanics.WireSetup, drive: DriveSetup, share: float) -> FullLink:
        wildest = _MOST_ACCELERATION / float(self.modes.wire_omega[-1]) ** 2
        return self._link_of_table(drive, share * _stable_step(self.modes) * 1e6)._replace(
            wire=np.array([
                dofs_of(self.model, [f"wire_{axis}{i:02d}" for i in range(mechanics.N_NODES)]) for axis in "xy"
            ]),
            reach_m=min(wire.guide_distance_m / 2, wildest),
            node_kg=self._node_mass,
            most_force_N=_MOST_ACCELERATION * float(self.model.body("wire_00").mass[0]),
        )


def _stable_step(modes: mechanics.ModalModel) -> float:
    """Return the longest time step in s at which no mode grows."""
    # semi-implicit Euler with explicit damping c = 2 zeta omega is stable up to ``omega^2 dt^2 + 2 c dt = 4``
    omega = np.concatenate([modes.wire_omega, modes.table_omega.ravel()])
    damping = 2 * np.concatenate([modes.wire_zeta, modes.table_zeta.ravel()]) * omega
    return float(np.min((np.sqrt(damping**2 + 4 * omega**2) - damping) / omega**2))


@compiled
def sound(link: FullLink) -> bool:
    """Return whether all numbers of the next MuJoCo step are finite and in range."""
    # otherwise MuJoCo would write a warning into a file
    for axis in range(2):
        for m in range(link.wire.shape[1]):
            dof = link.wire[axis, m]
            if not (
                abs(link.qpos[dof]) < link.reach_m
                and abs(link.qvel[dof]) * link.timestep[0] < link.reach_m
                and abs(link.force[dof]) < link.most_force_N
            ):
                return False
        for dof in (link.carriage[axis], link.rotor[axis]):
            if not (abs(link.qpos[dof]) < 1e6 and abs(link.qvel[dof]) < 1e6 and abs(link.force[dof]) < 1e6):
                return False
    return True


@compiled
def _drive(state: NDArray[np.void], axes: Axes, link: FullLink) -> None:
    """Apply the motors' torques and the friction of the ways."""
    for axis in range(2):
        rotor = link.rotor[axis]
        if axes.drives[axis].sample != 0:
            row, motor = axes.rows[axis], axes.motors[axis]
            damping = screw_damping(row, motor)  # not in MuJoCo, because it is 0 within the backlash
            link.force[link.carriage[axis]] = damping + motor.load_N + row.hand_N
            torque = energise(row, motor, link.timestep[0])
            link.force[rotor] = torque + row.hand_Nm - damping * motor.um_per_rad * 1e-6
            continue
        link.force[link.carriage[axis]] = -link.friction_N * link.friction_share[axis]
        # the torque has the period of a tooth: the rotor may stay four full steps off without being detected
        lead = link.qpos[rotor] - state[0].commanded_um[axis] * link.rad_per_um[axis]
        link.force[rotor] = -link.holding_Nm[axis] * math.sin(link.teeth * lead)


@compiled
def _rub(link: FullLink, axis: int, travel_m: float) -> None:
    """Update the friction after a travel by Dahl's law, exactly for a travel in one direction."""
    # ``dz/dx = 1 - z sign(dx) / presliding`` for the bristles' deflection z, here as a share of the greatest one
    left = math.exp(-abs(travel_m) / link.presliding_m)
    toward = 1.0 if travel_m > 0.0 else -1.0
    link.friction_share[axis] = toward + (link.friction_share[axis] - toward) * left


@compiled
def _brake_axis(axes: Axes, link: FullLink, axis: int, rotor_rad_s: float, carriage_m_s: float) -> None:
    """Apply dry friction to the speeds of rotor and carriage after a time step."""
    motor, dt = axes.motors[axis], link.timestep[0]
    rotor, carriage = link.rotor[axis], link.carriage[axis]
    change = rotor_after_friction(axes.rows[axis], motor, rotor_rad_s, link.qvel[rotor], dt) - link.qvel[rotor]
    link.qvel[rotor] += change
    link.qpos[rotor] += change * dt
    after_um_s = table_after_friction(motor, carriage_m_s * 1e6, link.qvel[carriage] * 1e6, dt)
    change = after_um_s * 1e-6 - link.qvel[carriage]
    link.qvel[carriage] += change
    link.qpos[carriage] += change * dt


@compiled
def step(state: NDArray[np.void], axes: Axes, link: FullLink) -> bool:
    """Make one time step of MuJoCo under the forces on the wire; return False if a number is out of range."""
    _drive(state, axes, link)
    if not sound(link):
        return False
    x, y = link.qpos[link.carriage[0]], link.qpos[link.carriage[1]]
    x_speed, y_speed = link.qvel[link.carriage[0]], link.qvel[link.carriage[1]]
    x_rotor, y_rotor = link.qvel[link.rotor[0]], link.qvel[link.rotor[1]]
    call_with_two(link.mj_step, link.model, link.data)
    if axes.drives[0].sample != 0:
        _brake_axis(axes, link, 0, x_rotor, x_speed)
    else:
        _rub(link, 0, link.qpos[link.carriage[0]] - x)
    if axes.drives[1].sample != 0:
        _brake_axis(axes, link, 1, y_rotor, y_speed)
    else:
        _rub(link, 1, link.qpos[link.carriage[1]] - y)
    return True


@compiled
def update_axes(state: NDArray[np.void], axes: Axes, link: FullLink, until_ns: int) -> None:
    """Update the servo axes and their encoders after MuJoCo has moved them."""
    for axis in range(2):
        if axes.drives[axis].sample == 0:
            continue
        drive, row, motor = axes.drives[axis], axes.rows[axis], axes.motors[axis]
        before = position(row, motor)
        row.place_um = state[0].axis_um[axis] = link.qpos[link.carriage[axis]] * 1e6
        row.speed_um_s = link.qvel[link.carriage[axis]] * 1e6
        row.rotor_um = link.qpos[link.rotor[axis]] * motor.um_per_rad
        row.speed_rad_s = link.qvel[link.rotor[axis]]
        see_edges(drive, row, motor, before, float(row.moved_ns), float(until_ns))
        watch_cam(row, motor, float(until_ns))
        row.moved_ns = until_ns


@compiled
def copy_axes_to_mujoco(axes: Axes, link: FullLink) -> None:
    """Copy positions and speeds of the servo axes to MuJoCo."""
    for axis in range(2):
        if axes.drives[axis].sample != 0:
            row, motor = axes.rows[axis], axes.motors[axis]
            link.qpos[link.carriage[axis]] = row.place_um * 1e-6
            link.qvel[link.carriage[axis]] = row.speed_um_s * 1e-6
            link.qpos[link.rotor[axis]] = row.rotor_um / motor.um_per_rad
            link.qvel[link.rotor[axis]] = row.speed_rad_s


@compiled
def coast_table(state: NDArray[np.void], axes: Axes, link: FullLink, until_ns: int) -> bool:
    """Step a table without a wire to a time, with constant drive outputs; False if its state is out of range."""
    start_ns = state[0].time_ns
    span_ns = until_ns - start_ns
    if span_ns <= 0:
        return True
    steps = math.ceil(span_ns * 1e-3 / link.longest_us)
    link.timestep[0] = span_ns * 1e-9 / steps
    for k in range(steps):
        if not step(state, axes, link):
            return False
        update_axes(state, axes, link, start_ns + span_ns * (k + 1) // steps)
    state[0].time_ns = until_ns
    return True


@compiled
def _copy_to_mujoco(state: NDArray[np.void], a: Arrays, link: FullLink) -> None:
    """Copy positions and velocities from the plant's arrays to MuJoCo."""
    for axis in range(2):
        for m in range(link.wire.shape[1]):
            dof = link.wire[axis, m]
            link.qpos[dof] = a.wire_q[axis, m] * 1e-6
            link.qvel[dof] = a.wire_v[axis, m] * 1e-6
        carriage, rotor, turn = link.carriage[axis], link.rotor[axis], link.rad_per_um[axis]
        link.qpos[carriage] = (state[0].axis_um[axis] + a.table_q[axis, 0]) * 1e-6
        link.qvel[carriage] = a.table_v[axis, 0] * 1e-6
        link.qpos[rotor] = (state[0].axis_um[axis] + a.table_q[axis, 1]) * turn
        link.qvel[rotor] = a.table_v[axis, 1] * turn


@compiled
def _copy_from_mujoco(state: NDArray[np.void], a: Arrays, axes: Axes, link: FullLink) -> None:
    """Copy positions and velocities from MuJoCo to the plant's arrays."""
    for axis in range(2):
        for m in range(link.wire.shape[1]):
            dof = link.wire[axis, m]
            a.wire_q[axis, m] = link.qpos[dof] * 1e6
            a.wire_v[axis, m] = link.qvel[dof] * 1e6
        carriage, rotor, turn = link.carriage[axis], link.rotor[axis], link.rad_per_um[axis]
        if axes.drives[axis].sample != 0:
            state[0].axis_um[axis] = link.qpos[carriage] * 1e6
        a.table_q[axis, 0] = link.qpos[carriage] * 1e6 - state[0].axis_um[axis]
        a.table_v[axis, 0] = link.qvel[carriage] * 1e6
        a.table_q[axis, 1] = link.qpos[rotor] / turn - state[0].axis_um[axis]
        a.table_v[axis, 1] = link.qvel[rotor] / turn


@compiled
def _push(a: Arrays, link: FullLink, s: int, impulse_x: float, impulse_y: float) -> None:
    """Apply an impulse (N s) on a slice to the last time step: to the speeds, and through them to the positions."""
    dt = link.timestep[0]
    for m in range(link.wire.shape[1]):
        share = a.shape[s, m] / link.node_kg[m]
        x, y = link.wire[0, m], link.wire[1, m]
        link.qvel[x] += share * impulse_x
        link.qvel[y] += share * impulse_y
        link.qpos[x] += share * impulse_x * dt
        link.qpos[y] += share * impulse_y * dt


@compiled
def _moved_um(a: Arrays, link: FullLink, films: Array, s: int) -> float:
    """Return a slice's motion (um) towards the metal since the beginning of the pulse, still in `Arrays.wire_q`."""
    moved_um = 0.0
    for m in range(link.wire.shape[1]):
        x, y = link.qpos[link.wire[0, m]] * 1e6, link.qpos[link.wire[1, m]] * 1e6
        moved_um += a.shape[s, m] * ((x - a.wire_q[0, m]) * films[s, 0] + (y - a.wire_q[1, m]) * films[s, 1])
    return float(moved_um)


@compiled
def _add_growth(a: Arrays, link: FullLink, films: Array, scale: float) -> None:
    """Add to the forces the growth of the pull on slices near the metal since the beginning of the pulse."""
    for s in range(films.shape[0]):
        if films[s, 3] == 0.0:
            continue
        growth = film_now(films, s, 0.0, _moved_um(a, link, films, s))[1] * scale * 1e-6
        for m in range(link.wire.shape[1]):
            link.force[link.wire[0, m]] += a.shape[s, m] * growth * films[s, 0]
            link.force[link.wire[1, m]] += a.shape[s, m] * growth * films[s, 1]


@compiled
def _brake(a: Arrays, c: Constants, link: FullLink, films: Array, mean: float, resistance: float) -> None:
    """Apply the resistance of the mean film and of the slices' films after a time step."""
    # for an effective mass m, a speed v becomes ``v / (1 + c dt / m)``, which is stable for any film
    dt = link.timestep[0]
    for m in range(link.wire.shape[1]):
        taken = 1.0 - 1.0 / (1.0 + a.mobility[m] * resistance * dt)
        for axis in range(2):
            dof = link.wire[axis, m]
            change = link.qvel[dof] * taken
            link.qvel[dof] -= change
            link.qpos[dof] -= change * dt
    for s in range(films.shape[0]):
        if films[s, 3] == 0.0:
            continue
        nx, ny, speed = films[s, 0], films[s, 1], 0.0
        for m in range(link.wire.shape[1]):
            x, y, shape = link.wire[0, m], link.wire[1, m], a.shape[s, m]
            speed += shape * (link.qvel[x] * nx + link.qvel[y] * ny)
        film = film_now(films, s, mean, _moved_um(a, link, films, s))[0]
        drag = film / (1.0 + film * dt / a.slice_mass_kg[s])
        impulse = suction_limited(a, c, s, -drag * speed * 1e6) * 1e-6 * dt
        _push(a, link, s, impulse * nx, impulse * ny)


@compiled
def _overlap(begin: float, end: float, low: float, high: float) -> float:
    """Return the length of the overlap of two spans."""
    return max(0.0, min(end, high) - max(begin, low))


@compiled
def move_full(
    state: NDArray[np.void], a: Arrays, c: Constants, axes: Axes, link: FullLink, p: Propagators, t: Timing,
    load: Array, films: Array, mean: float, resistance: float, open_scale: float, burn_scale: float,
    ignite_us: float, end_us: float, period_ns: int, s: int, kick_x: float, kick_y: float,
    events: NDArray[np.int64], next_event: int,
) -> int:
    """Step the full model over the period of a pulse that starts at the state's time, which is not changed."""
    # Does the same as `modal.move` and `advance_axes`, in equal time steps: the pull (um kg/s2 times the scales) acts
    # with its mean over each step, the kick (N s) on slice `s` at `end_us`. Returns the first event after the period;
    # `TRIPPED` if an axis must be stopped; `LOST` if a coordinate is out of range or not finite.
    period_us = period_ns * 1e-3
    n_steps = math.ceil(period_us / link.longest_us)
    dt_us = period_us / n_steps
    link.timestep[0] = dt_us * 1e-6
    _copy_to_mujoco(state, a, link)
    # the kick is divided between two time steps so that its mean time is exact; in the last step it comes early
    kicked = min(int(end_us / dt_us), n_steps - 1)
    second = end_us / dt_us - kicked if kicked < n_steps - 1 else 0.0
    fine = True
    for k in range(n_steps):
        until_ns = state[0].time_ns + period_ns * (k + 1) // n_steps
        next_event = advance_axes(state, a, axes, p, t, 0, link.step_um, events, next_event, until_ns, True)
        if next_event < 0:
            break
        begin, end = k * dt_us, (k + 1) * dt_us
        scale = (
            open_scale * _overlap(begin, end, 0.0, ignite_us) + burn_scale * _overlap(begin, end, ignite_us, end_us)
        ) / dt_us
        kick = 0.0
        if k == kicked:
            kick = (1.0 - second) / link.timestep[0]
        elif k == kicked + 1:
            kick = second / link.timestep[0]
        for m in range(link.wire.shape[1]):
            share = a.shape[s, m] * kick
            link.force[link.wire[0, m]] = (load[0, m] * scale + a.steady[0, m]) * 1e-6 + share * kick_x
            link.force[link.wire[1, m]] = (load[1, m] * scale + a.steady[1, m]) * 1e-6 + share * kick_y
        _add_growth(a, link, films, scale)
        fine = step(state, axes, link)
        if not fine:
            break
        _brake(a, c, link, films, mean, resistance)
        if axes.loops != 0:
            update_axes(state, axes, link, until_ns)
    _copy_from_mujoco(state, a, axes, link)
    return next_event if fine and sound(link) else LOST
