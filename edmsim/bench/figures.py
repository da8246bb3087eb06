"""Speed of this computer: measure all figures of ``edmsim bench`` and show them as a table."""

from __future__ import annotations

from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from rich.console import RenderableType


def measure() -> dict[str, float]:
    """Return all figures by name; ``realtime_factor`` is for the default resolution at its own period.

    Single-threaded work is timed in processor time, which excludes other programs; multi-threaded work
    (``vector_env...``, ``half_cheetah...``, ``threads_...``) in wall-clock time.

    ``ray_sums_per_s`` is the upper bound of the first figure, ``ray_sum_share`` the share of its time in ray sums;
    ``controller_overhead`` is the share of time that the registers of 1982 add to a cut;
    ``literal_realtime_factor`` is for a cut in which the timers of 1982 make the steps;
    ``servo_realtime_factor`` is for a servo drive with its motor and table,
    ``positioner_realtime_factor`` for an analogue positioner with a sample time of 1 ms; ``elcam_load_s`` and
    ``elcam_lookup_us`` are for a cam table of a million points;
    ``turned_knobs_cost`` is the time of an environment's step that changes generator settings over one that does
    not; ``drawn_reset_ms`` is the time of a reset that draws a machine, and ``drawn_machines_cost`` the time of an
    episode with such a reset over one without;
    ``thread_efficiency`` is the gain of two plants in two threads over that of two compute loops;
    ``vector_env_steps_per_s_fast`` is for 64 environments, ``half_cheetah_vector_steps_per_s`` for 64
    HalfCheetah-v5, which Gymnasium steps one after another.

    Raises
    ------
    InputError
        If ``gymnasium[mujoco]`` is not installed.
    """
    comparison = half_cheetah_comparison()
    default, plant = pulses_per_s("default")
    bound = ray_sums_per_s(plant)
    plants, loops = thread_scaling()
    return {
        "pulses_per_s": default,
        "realtime_factor": default * Machine.load().t_period_us * 1e-6,
        "pulses_per_s_fast": pulses_per_s("fast")[0],
        "pulses_per_s_fine": pulses_per_s("fine")[0],
        "ray_sums_per_s": bound,
        "ray_sum_share": default / bound,
        "mujoco_realtime_factor": mujoco_realtime_factor(),
        "servo_realtime_factor": servo_realtime_factor(),
        "positioner_realtime_factor": positioner_realtime_factor(),
        **elcam_figures(),
        "env_steps_per_s": env_steps_per_s(),
        "vector_env_steps_per_s": vector_env_steps_per_s(),
        **comparison,
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


def render(figures: dict[str, float]) -> RenderableType:
    """Return the figures as a table for the terminal."""
    from edmsim.screen import ScreenTable

    table = ScreenTable("figure", numbers=("value",), title="edmsim bench")
    for name, value in figures.items():
        table.add_row(name, f"{value:,.0f}" if value > 1000 else f"{value:,.2f}")
    return table
