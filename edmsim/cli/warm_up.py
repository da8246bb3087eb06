"""``edmsim warm-up``: compile beforehand what a cut, an environment or a study would wait for."""

from __future__ import annotations

from edmsim.cli.console import OUT


def warm_up() -> None:
    """Compile the pulse loop for all resolutions and both integrators, two side by side."""
    from concurrent.futures import ThreadPoolExecutor

    from edmsim.plant.kernel.memory import window_function
    from edmsim.plant.plant import shapes
    from edmsim.progress import ShownProgress

    with ShownProgress() as bar, ThreadPoolExecutor(2) as pool:
        bar.show("compile", 0, len(shapes()))
        for done, _ in enumerate(pool.map(lambda shape: window_function(*shape), shapes()), 1):
            bar.show("compile", done, len(shapes()))
    OUT.print("The pulse loop is compiled for all resolutions.")
