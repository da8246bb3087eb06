"""The notebooks run, and what a reader sees of them is what they are."""

import ast
import base64
import contextlib
import io
import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

FOLDER = Path(__file__).parents[2] / "notebooks"
NAMES = [file.stem for file in sorted(FOLDER.glob("[0-9][0-9]-*.py"))]
MACHINE_PATHS = re.compile(r"(?<![\w./])/(home|root|tmp|var|work|usr|opt|Users|mnt)/|[A-Z]:\\\\|site-packages")
LARGEST_BYTES = 600_000
SHORT_EPISODES = """
from functools import partialmethod
from edmsim.envs.episode import Task
Task.__init__ = partialmethod(Task.__init__, episode_s=4.0)
"""
SHORT_TRAINING = SHORT_EPISODES + """
from edmsim.learning import hyperparameters
load = hyperparameters.load
hyperparameters.load = lambda *of: load(*of).model_copy(update={"num_envs": 32})  # a batch of the buffer
"""
THIN_STOCK = """
from edmsim.sweep import specification as module
from edmsim import runs
runs.Processes = lambda _=None: runs.Threads()
usual = module.Specification
module.Specification = lambda settings, **more: usual(settings={**settings, "height_mm": 5.0}, **more)
"""
SHORTER = {
    "04-gap-controllers": SHORT_EPISODES, "05-train-a-policy": SHORT_TRAINING, "13-offline": SHORT_EPISODES,
    "12-sweep": THIN_STOCK,
    "09-calibrate": "from edmsim.calibration import comparison, fit\ncomparison.NOISE_CUTS, fit.MOST_ROUNDS = 8, 1",
}  # fmt: skip
"""What is run before a notebook whose work its small settings cannot shorten."""


@pytest.fixture(scope="module")
def execute(load_script):
    """The script that makes the notebooks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # jupyter's packages, not ours
        return load_script(FOLDER / "execute.py")


def shown(file):
    """A notebook as it is written, by its JSON alone."""
    return json.loads(file.read_text(encoding="utf-8"))


def text(source):
    return source if isinstance(source, str) else "".join(source)


def code(notebook):
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def speaking(notebook):
    """Source of the code cells that show something."""
    return [text(cell["source"]) for cell in code(notebook) if cell["outputs"]]


def test_there_are_notebooks():
    assert NAMES, "no notebook found"
    assert {file.stem for file in FOLDER.glob("*.ipynb")} == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_text_and_notebook_hold_the_same_cells(name, execute):
    written = shown(FOLDER / f"{name}.ipynb")
    read = execute.read(FOLDER / f"{name}.py")
    assert [(c["cell_type"], text(c["source"]), c["metadata"]) for c in written["cells"]] == [
        (c.cell_type, c.source, dict(c.metadata)) for c in read.cells
    ], "make notebooks"
    assert written["metadata"] == read.metadata


@pytest.mark.parametrize("name", NAMES)
def test_outputs_are_there_and_fit_for_readers(name):
    file = FOLDER / f"{name}.ipynb"
    assert file.stat().st_size < LARGEST_BYTES
    cells = code(shown(file))
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    for output in outputs:
        assert output["output_type"] != "error"
        assert output.get("name") != "stderr"
        read = "\n".join(text(v) for k, v in {**output.get("data", {}), "t": output.get("text", "")}.items()
                         if k != "image/png")  # fmt: skip
        assert not MACHINE_PATHS.search(read), read
        assert not re.fullmatch(r"<.* at 0x[0-9a-f]+>", read.strip()), read


@pytest.mark.parametrize("name", NAMES)
def test_small_settings_are_parameters(name, execute):
    notebook = execute.read(FOLDER / f"{name}.py")
    (cell,) = [c for c in notebook.cells if execute.PARAMETERS in execute.tags(c)]
    assigned = {target.id for node in ast.parse(cell.source).body for target in node.targets}
    small = set(notebook.metadata["edmsim"]["small"])
    assert small
    assert small <= assigned


def test_the_table_names_every_notebook():
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| \[([\w-]+)\]\(\1\.ipynb\) \|", page, re.MULTILINE) == NAMES


@pytest.fixture(scope="module")
def kernel(execute):
    """A process that executes them: it imports and loads compiled code once."""
    with execute.Kernel() as kernel:
        yield kernel


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", NAMES)
def test_executes_with_the_small_settings(name, execute, kernel):
    notebook = execute.read(FOLDER / f"{name}.py")
    execute.make_small(notebook)
    if name in SHORTER:
        notebook.cells.insert(0, execute.nbformat.v4.new_code_cell(SHORTER[name]))
    execute.run(notebook, kernel)
    assert speaking(notebook) == speaking(shown(FOLDER / f"{name}.ipynb"))


@pytest.mark.slow
def test_a_notebook_finds_nothing_of_the_one_before(execute, kernel):
    first, second = (execute.nbformat.v4.new_notebook() for _ in range(2))
    cell = execute.nbformat.v4.new_code_cell
    first.cells = [cell("left = 1"), cell("open('file', 'w').close()"), cell("import matplotlib.pyplot as plt"),
                   cell("plt.rcParams['figure.dpi'] = 7.0")]  # fmt: skip
    second.cells = [cell("import os, matplotlib"), cell("'left' in globals(), os.listdir(), "
                    "matplotlib.rcParams['figure.dpi'] == 7.0")]  # fmt: skip
    for notebook in (first, second):
        kernel.execute(notebook)
    (output,) = second.cells[1].outputs
    assert (output.execution_count, output.data["text/plain"]) == (2, "(False, [], False)")


@pytest.mark.slow
@pytest.mark.parametrize(("source", "said"), [
    ("1 / 0", "ZeroDivisionError"), ("import warnings; warnings.warn('mind')", "wrote to stderr: .*mind"),
])  # fmt: skip
def test_a_cell_that_fails_or_warns_is_noticed(execute, kernel, source, said):
    notebook = execute.nbformat.v4.new_notebook(cells=[execute.nbformat.v4.new_code_cell(source)])
    with pytest.raises((execute.CellExecutionError, RuntimeError), match=said):
        execute.run(notebook, kernel)


@pytest.mark.slow
def test_a_smaller_picture_has_no_other_colours(execute):
    ramp = np.linspace(0, 255, 64, dtype=np.uint8)
    picture = np.stack(np.broadcast_arrays(ramp, ramp[:, None], ramp[::-1, None]), axis=-1)  # far more than 256
    picture[25, 25:28] = (0, 114, 178)  # a curve of few pixels
    made = execute.in_few_colours(base64.b64encode(png(picture)).decode())
    again = np.asarray(Image.open(io.BytesIO(base64.b64decode(made))).convert("RGB")).astype(int)
    assert np.abs(again - picture).max() <= execute.SAME_SHADE


def png(picture):
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    return file.getvalue()


def test_small_outputs_do_not_replace_the_committed_ones(execute):
    with pytest.raises(SystemExit, match="2"):
        execute.main([NAMES[0], "--small"])


def test_a_new_folder_is_made_for_the_outputs(execute, monkeypatch, tmp_path):
    monkeypatch.setattr(execute, "Kernel", contextlib.nullcontext)
    monkeypatch.setattr(execute, "run", lambda notebook, kernel: None)
    assert execute.main([NAMES[0], "--small", "--out", str(tmp_path / "new" / "small")]) == 0
    assert (tmp_path / "new" / "small" / f"{NAMES[0]}.ipynb").is_file()


def test_a_notebook_that_is_not_there_is_reported(execute, capsys):
    with pytest.raises(SystemExit, match="2"):
        execute.main(["99-nothing"])
    assert f"there is no notebook '99-nothing'; there are {NAMES[0]}" in capsys.readouterr().err
