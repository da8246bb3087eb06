"""``edmsim warm-up``: compile beforehand what a cut, an environment or a study would wait for."""

from __future__ import annotations

from edmsim.cli.console import ERR, OUT


def warm_up() -> None:
    """Compile the pulse loop for all resolutions and both integrators, two side by side."""
    from concurrent.futures import ThreadPoolExecutor

    from edmsim.plant.kernel.memory import window_function
    from edmsim.plant.plant import shapes
    from edmsim.screen import ScreenProgress

    with ScreenProgress(console=ERR, transient=True) as bar, ThreadPoolExecutor(2) as pool:
        task = bar.add_task("compile", total=len(shapes()))
        for _ in pool.map(lambda shape: window_function(*shape), shapes()):
            bar.advance(task)
    OUT.print("The pulse loop is compiled for all resolutions.")
