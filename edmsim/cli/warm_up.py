"""``edmsim warm-up``: compile beforehand what a cut, an environment or a study would wait for."""

from __future__ import annotations

from edmsim.cli.console import OUT

_LINE = "G0 X0 Y0\nG1 X0.5\nM2\n"


def warm_up() -> None:
    """Compile beforehand what cuts and environments would wait for."""
    from concurrent.futures import ThreadPoolExecutor

    from edmsim.plant.kernel.memory import window_function
    from edmsim.plant.plant import shapes
    from edmsim.progress import ShownProgress

    total = len(shapes()) + 1
    with ShownProgress() as bar, ThreadPoolExecutor(2) as pool:
        bar.show("compile", 0, total)
        for done, _ in enumerate(pool.map(lambda shape: window_function(*shape), shapes()), 1):
            bar.show("compile", done, total)
        _use_once()
        bar.show("compile", total, total)
    OUT.print("All code of cuts and environments is compiled, for all resolutions.")


def _use_once() -> None:
    """Make a cut and a step of an environment: planners, observations and rewards are compiled with their types."""
    import tempfile
    from pathlib import Path

    import gymnasium as gym

    import edmsim
    import edmsim.envs

    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "line.ngc"
        program.write_text(_LINE, encoding="ascii")
        edmsim.cut(program, offset="none", resolution="fast", max_time_s=0.1)
    env = gym.make("edmsim/GapFeed-v2", resolution="fast")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
