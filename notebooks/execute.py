"""Execute notebooks: what jupytext reads from ``NN-name.py`` becomes ``NN-name.ipynb`` with its outputs.

    python notebooks/execute.py                          all of them, full settings: `make notebooks`
    python notebooks/execute.py 01-first-cut             one of them
    python notebooks/execute.py --small --out FOLDER     with the small settings of their headers, as the tests do

A notebook that fails or writes to stderr leaves its file as it was.
"""

import argparse
import asyncio
import base64
import io
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jupytext
import nbformat
import numpy as np
from ipykernel.kernelspec import get_kernel_dict
from jupyter_client.kernelspec import KernelSpec, KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbformat import NotebookNode
from PIL import Image

HERE = Path(__file__).resolve().parent
PARAMETERS = "parameters"
"""Tag of the cell that holds everything that makes a notebook big."""
INJECTED = "injected-parameters"
"""Tag of the cell that replaces some of them by the small ones."""
LANGUAGE = {"name": "python", "file_extension": ".py", "pygments_lexer": "ipython3"}
CELL_TIMEOUT_S = 900
BEGIN = """
import os as _os, matplotlib as _matplotlib
_os.chdir({folder!r})
_matplotlib.rcdefaults()
get_ipython().reset()
get_ipython().execution_count = 1
"""
"""What a notebook finds as in a process of its own."""
SAME_SHADE = 8
"""Colours of a picture that differ by no more in red, green and blue (of 255) are one."""


class ThisInterpreter(KernelSpecManager):
    """Whatever kernel a notebook names, the interpreter that runs this file is it."""

    def get_kernel_spec(self, kernel_name: str) -> KernelSpec:
        """Return how to start it."""
        return KernelSpec(**get_kernel_dict())


class OwnKernel(AsyncKernelManager):
    """A kernel in this interpreter, spoken to through sockets in a folder of its own that nobody else can reach."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings, transport="ipc", kernel_spec_manager=ThisInterpreter())


def sources() -> list[Path]:
    """Return the notebooks' texts, in order."""
    return sorted(HERE.glob("[0-9][0-9]-*.py"))


def read(source: Path) -> NotebookNode:
    """Return a notebook without outputs; its cells are numbered, so that a second reading is the same."""
    notebook = jupytext.read(source)
    notebook.metadata["jupytext"].pop("text_representation", None)
    notebook.metadata["language_info"] = LANGUAGE
    notebook.nbformat_minor = 5  # cells have ids from here on
    for number, cell in enumerate(notebook.cells, 1):
        cell["id"] = f"cell-{number}"
    return notebook


def tags(cell: NotebookNode) -> list[str]:
    """Return the tags of a cell."""
    return list(cell.metadata.get("tags", ()))


def make_small(notebook: NotebookNode) -> None:
    """Put the settings of ``edmsim.small`` behind the parameters."""
    place = next(n for n, cell in enumerate(notebook.cells) if PARAMETERS in tags(cell))
    settings = notebook.metadata["edmsim"]["small"]
    cell = nbformat.v4.new_code_cell(
        "\n".join(f"{name} = {value!r}" for name, value in settings.items()), id=INJECTED,
        metadata={"tags": [INJECTED]},
    )
    notebook.cells.insert(place + 1, cell)


class Kernel:
    """A process that executes notebooks one after the other, each in an empty folder and with no names of another."""

    def __enter__(self) -> "Kernel":
        self._own = tempfile.TemporaryDirectory()
        self._runner = asyncio.Runner()
        self._manager = OwnKernel(ip=f"{self._own.name}/kernel")
        # not the user's own settings of IPython; and no bars: their times are never the same
        surroundings = {**os.environ, "IPYTHONDIR": self._own.name, "EDMSIM_PROGRESS": "0"}
        self._runner.run(self._manager.start_kernel(env=surroundings, cwd=self._own.name))
        return self

    def __exit__(self, *_: object) -> None:
        self._runner.run(self._manager.shutdown_kernel(now=True))
        self._runner.close()
        self._own.cleanup()

    def execute(self, notebook: NotebookNode) -> None:
        """Execute in place.

        Raises
        ------
        CellExecutionError
            If a cell fails.
        """
        client = NotebookClient(
            notebook, timeout=CELL_TIMEOUT_S, record_timing=False, coalesce_streams=True, km=self._manager
        )
        with tempfile.TemporaryDirectory() as folder:

            async def begin(notebook: NotebookNode) -> None:
                await client.kc.execute(BEGIN.format(folder=folder), silent=True, reply=True)

            client.on_notebook_start = begin
            try:
                self._runner.run(client.async_execute())
            finally:
                client.kc.stop_channels()


def run(notebook: NotebookNode, kernel: Kernel) -> None:
    """Execute in place.

    Raises
    ------
    CellExecutionError
        If a cell fails.
    RuntimeError
        If a cell writes to stderr, as a warning does.
    """
    kernel.execute(notebook)
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if output.get("name") == "stderr":
                raise RuntimeError(f"{cell['id']} wrote to stderr: {output['text']}")


def make_publishable(notebook: NotebookNode) -> None:
    """Make the pictures small, and leave out what says more of this interpreter than the notebooks do."""
    notebook.metadata["language_info"] = LANGUAGE
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", ()):
                output["data"]["image/png"] = in_few_colours(output["data"]["image/png"])


def in_few_colours(png_base64: str) -> str:
    """Return a picture at a third of its size: shades of smoothed edges become the nearest frequent colour."""
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(png_base64))).convert("RGB"))
    colours, place, count = np.unique(picture.reshape(-1, 3), axis=0, return_inverse=True, return_counts=True)
    kept, becomes = np.empty((0, 3)), np.zeros(len(colours), int)
    for number in np.argsort(-count, kind="stable"):
        away = np.abs(kept - colours[number]).max(axis=1, initial=0)
        if not len(kept) or away.min() > SAME_SHADE:
            kept, away = np.vstack([kept, colours[number]]), np.append(away, 0)
        becomes[number] = away.argmin()
    indices, palette = becomes[place.ravel()].reshape(picture.shape[:2]), kept.astype(np.uint8)
    if len(palette) > 256:
        few = Image.fromarray(palette[indices])
    else:
        few = Image.fromarray(indices.astype(np.uint8))
        few.putpalette(palette.ravel().tolist())
    file = io.BytesIO()
    few.save(file, "PNG", optimize=True)
    return base64.b64encode(file.getvalue()).decode("ascii")


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute the notebooks named on the command line; return the exit status."""
    parser = argparse.ArgumentParser(description="Execute notebooks and keep their outputs.")
    parser.add_argument("names", nargs="*", help="01-first-cut, ...; all if none is named")
    parser.add_argument("--small", action="store_true", help="small settings; needs --out")
    parser.add_argument("--out", type=Path, default=HERE, help="folder for the .ipynb files; else beside the .py")
    given = parser.parse_args(arguments)
    there = {source.stem: source for source in sources()}
    unknown = [name for name in given.names if name not in there]
    if unknown:
        parser.error(f"there is no notebook {unknown[0]!r}; there are {', '.join(there)}")
    if given.small and given.out.resolve() == HERE:
        parser.error("--small needs --out: outputs of the small settings do not belong beside the notebooks")
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.names or there:
        notebook = read(there[name])
        if given.small:
            make_small(notebook)
        began = time.monotonic()
        try:
            with Kernel() as kernel:  # a process of its own
                run(notebook, kernel)
        except (CellExecutionError, RuntimeError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 1
        make_publishable(notebook)
        nbformat.write(notebook, given.out / f"{name}.ipynb")
        print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
