"""A machine's MJCF: read once, with a check of the names that the plant needs."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from edmsim import models
from edmsim.errors import InputError
from edmsim.machine.machine import mjcf_version

if TYPE_CHECKING:
    import mujoco

NEEDED: dict[str, tuple[str, ...]] = {
    "body": ("x_carriage", "y_carriage", "upper_arm"),
    "joint": ("x", "y", "x_rotor", "y_rotor"),
    "site": ("lower_guide", "upper_guide"),
    "geom": ("workpiece", "clamp_left", "clamp_right"),
    "tendon": ("x_screw", "y_screw"),
    "actuator": ("x_stepper", "y_stepper"),
    "numeric": ("rotor_teeth",),
    "camera": ("overview",),
}
"""Names that plant, playback and pictures ask for, by kind; the chain of the wire has names of its own."""
LEAST_NODES = 25  # nodes of the wire that MuJoCo steps in the loop (see `edmsim.plant.mechanics.mujoco_table`)


def read(model_file: str) -> mujoco.MjSpec:
    """Return a machine's MJCF, with all that the plant asks for by name; it is to be copied, not changed."""
    return _read(model_file, mjcf_version(model_file))


@functools.lru_cache(maxsize=8)  # reading takes four times as long as fitting a wire and compiling
def _read(model_file: str, _version: int) -> mujoco.MjSpec:
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(models.path(model_file)))
        spec.copy().compile()
    except ValueError as error:
        raise InputError(f"MuJoCo cannot use this MJCF: {' '.join(str(error).split())}", model_file) from None
    try:
        missing = lacking(spec)
    except UnicodeDecodeError:
        raise InputError("this MJCF has names that are not UTF-8: save it as UTF-8", model_file) from None
    if missing:
        raise InputError(f"this MJCF has no {', no '.join(missing)}", model_file)
    return spec


def lacking(spec: mujoco.MjSpec) -> list[str]:
    """Return what a MJCF lacks, each as kind and name."""
    listed: dict[str, Any] = {
        "body": spec.bodies, "joint": spec.joints, "site": spec.sites, "geom": spec.geoms, "tendon": spec.tendons,
        "actuator": spec.actuators, "numeric": spec.numerics, "camera": spec.cameras,
    }  # fmt: skip
    there = {kind: {item.name for item in items} for kind, items in listed.items()}
    missing = [f"{kind} {name}" for kind, names in NEEDED.items() for name in names if name not in there[kind]]
    nodes = max(LEAST_NODES, sum(name.startswith("wire_") for name in there["body"]))
    wire = {
        "body": [f"wire_{i:02d}" for i in range(nodes)],
        "joint": [f"wire_{axis}{i:02d}" for i in range(nodes) for axis in "xy"],
        "tendon": [f"segment_{i:02d}" for i in range(nodes + 1)],
    }
    return missing + [f"{kind} {name}" for kind, names in wire.items() for name in names if name not in there[kind]]


def screw_constants(model: mujoco.MjModel) -> tuple[dict[str, float], dict[str, float]]:
    """Return screws and tables of x and y as constants of `edmsim.compiled.axis_rows.MOTOR`."""
    found = []
    for axis in "xy":
        carriage, screw = model.joint(axis), model.tendon(f"{axis}_screw").id
        first = int(model.tendon_adr[screw])
        coefficients = model.wrap_prm[first : first + int(model.tendon_num[screw])]
        found.append({
            "um_per_rad": float(-coefficients.min() / coefficients.max()) * 1e6,
            "screw_N_m": float(model.tendon_stiffness[screw].flat[0]),
            "screw_N_s_m": float(model.tendon_damping[screw].flat[0]),
            "table_kg": float(model.body_subtreemass[carriage.bodyid[0]]),
            "way_N_s_m": float(model.dof_damping[carriage.dofadr[0]]),
        })
    return found[0], found[1]
