"""Speed of this computer: all figures of ``edmsim bench``."""

from __future__ import annotations

from edmsim.bench.controllers import (
    controller_overhead,
    elcam_figures,
    literal_realtime_factor,
    poscal_calls_per_s,
    positioner_realtime_factor,
    servo_realtime_factor,
)
from edmsim.bench.envs import (
    drawn_machines,
    env_steps_per_s,
    half_cheetah_comparison,
    turned_knobs_cost,
    vector_env_steps_per_s,
)
from edmsim.bench.plant import (
    cold_start_s,
    memory_growth_MB,
    mujoco_realtime_factor,
    pulses_per_s,
    ray_sums_per_s,
    thread_scaling,
)
from edmsim.machine.machine import Machine


def measure() -> dict[str, float]:
    """Return all figures by name: of threads by the clock, of all else by processor time, which excludes others."""
    comparison = half_cheetah_comparison()
    default, plant = pulses_per_s("default")
    bound = ray_sums_per_s(plant)
    plants, loops = thread_scaling()
    return {
        "pulses_per_s": default,
        "realtime_factor": default * Machine.load().t_period_us * 1e-6,  # at the resolution default
        "pulses_per_s_fast": pulses_per_s("fast")[0],
        "pulses_per_s_fine": pulses_per_s("fine")[0],
        "ray_sums_per_s": bound,  # if a pulse were nothing else
        "ray_sum_share": default / bound,
        "mujoco_realtime_factor": mujoco_realtime_factor(),
        "servo_realtime_factor": servo_realtime_factor(),
        "positioner_realtime_factor": positioner_realtime_factor(),
        **elcam_figures(),
        "env_steps_per_s": env_steps_per_s(),
        "vector_env_steps_per_s": vector_env_steps_per_s(),
        **comparison,  # of 64 environments each
        "turned_knobs_cost": turned_knobs_cost(),
        **drawn_machines(),
        "controller_overhead": controller_overhead(),
        "literal_realtime_factor": literal_realtime_factor(),
        "poscal_calls_per_s": poscal_calls_per_s(),
        "threads_plants": plants,
        "threads_compute": loops,
        "thread_efficiency": plants / loops,
        "memory_growth_MB": memory_growth_MB(),
        "cold_start_s": cold_start_s(),
    }
