"""The guide says what the code does: tables, options, outcomes, keys, codes, controllers."""

import importlib.util
import json
import pkgutil
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import edmsim
from edmsim import controllers
from edmsim.closed_loop.stops import WORDS, StopCause
from edmsim.errors import BAD_INPUT, FAILED, INTERRUPTED, STOPPED
from edmsim.plant.resolution import resolution
from edmsim.program import blocks, outline, path
from edmsim.recording import figures

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def page(name):
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def cells(text, column=0):
    """What stands in backticks in one column of a page's tables."""
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [name for row in rows if len(row) > column for name in re.findall(r"`([^`]+)`", row[column])]


@pytest.fixture(scope="module")
def tables(load_script):
    return load_script(DOCS / "make" / "tables.py")


@pytest.mark.slow
def test_tables_are_those_of_the_code(tables):
    marked = {str(file.relative_to(DOCS).with_suffix("")): file for file in tables.pages()}
    assert set(marked) == {"command-line", "controllers", "guide/outputs", "guide/set-up", "servo-drives"}
    for file in marked.values():
        text = file.read_text(encoding="utf-8")
        assert tables.refreshed(text) == text, f"{file.name} is out of date; run: python docs/make/tables.py"


def test_the_guide_explains_every_option_of_a_cut(tables):
    said = set(re.findall(r"--[a-z-]+", " ".join(cells(page("guide/cutting")))))
    section = tables.commands().split("## edmsim cut\n")[1].split("\n## ")[0]
    assert said == {name.split()[0] for name in cells(section) if name.startswith("--")} - {"--out"}


def test_resolutions():
    listed = re.findall(r"^\| `(\w+)`" + r" \| (\d+)" * 5 + r" \|$", page("guide/cutting"), re.MULTILINE)
    assert [name for name, *_ in listed] == ["fast", "default", "fine"]
    for name, *sizes in listed:
        res = resolution(name)
        assert tuple(map(int, sizes)) == (res.slices, res.rays, res.modes, res.cell_um, res.trace_windows)


def test_every_controller_has_its_law_source_and_parameters():
    text = page("controllers")
    sections = {part.split("\n")[0]: part for part in text.split("\n## ")[1:]}
    assert sections.keys() - {"What the servos share", "Trained policies"} == set(controllers.names())
    for name in controllers.names():
        assert re.search(r"^    .* (=|<-) ", sections[name], re.MULTILINE), name
        assert "\nSource: " in sections[name], name
        assert re.search(f"<!-- begin table: parameters {name}( [a-z-]+)? -->", sections[name]), name


def keys(value, before=""):
    """Names of a report's entries, those of inner ones behind a point; of lists of records the first is shown."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return keys(value[0], before) | {before}
    if isinstance(value, dict):
        return set().union(*(keys(inner, f"{before}.{key}" if before else key) for key, inner in value.items()))
    return {before}


@pytest.mark.slow
def test_the_outputs_are_those_of_a_cut(tmp_path):
    edmsim.cut(ROOT / "examples" / "punch.ngc", height_mm=10, resolution="fast", max_time_s=1, out=tmp_path)
    text = page("guide/outputs")
    files = text.split("\n## ")[0]
    report, drawing = (text.split(f"\n## {name}")[1].split("\n## ")[0] for name in ("report.json", "part.npz"))
    assert {file.name for file in tmp_path.iterdir()} == set(cells(files)) - {"checkpoint.npz"}
    with np.load(tmp_path / "part.npz") as part:
        fields, arrays = json.loads(part["fields"].tobytes()), {name: part[name] for name in part.files}
    assert set(cells(drawing)) == arrays.keys() | fields.keys() | {"fields"}
    for line in (line for line in drawing.splitlines() if re.match(r"\| `[^|]*\| (float64|int64|uint8) ", line)):
        names, shapes = cells(line), line.split(" | ")[1].split("; ")
        assert len(names) in (1, len(shapes))
        for name, (kind, shape) in zip(names, (shape.split(" ", 1) for shape in shapes), strict=False):
            assert (arrays[name].dtype.name, arrays[name].ndim) == (kind, shape.count(",") + (shape[-2] != ",")), name
            columns = re.search(r", (\d+)\)", shape)
            assert columns is None or arrays[name].shape[1] == int(columns[1]), name
    assert set(cells(report)) == keys(json.loads((tmp_path / "report.json").read_text(encoding="utf-8")))


def test_exit_statuses_and_outcomes():
    text = page("guide/outcomes")
    listed = [int(status) for status in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)]
    assert listed == [0, FAILED, BAD_INPUT, STOPPED, INTERRUPTED]
    ends = text.split("## How a cut ends")[1].split("\n## ")[0]
    causes = set(StopCause) - {StopCause.RUNNING, StopCause.OUT_OF_RANGE}  # the second is an error, no outcome
    assert set(cells(ends)) - {"--max-time"} == {WORDS[cause].report for cause in causes}


def test_the_error_shown_is_the_one_a_user_sees(tmp_path, monkeypatch, edmsim):
    command, shown = re.findall(r"```(?:sh|output)\n(.*?)```", page("guide/outcomes"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    assert edmsim(*command.split()[1:]) == (BAD_INPUT, "", shown)
    assert not Path("out").exists()


def test_the_words_of_programs():
    table = page("guide/programs").split("## Drawings")[0]
    rows = "\n".join(line for line in table.splitlines() if line.startswith("| "))
    named = set(re.findall(r"[GM]\d+(?:\.\d)?", rows))
    assert named == {f"{letter}{n}" for letter, codes in blocks.KNOWN.items() for n in codes}


def test_the_lengths_of_programs():
    words = " ".join(page("guide/programs").split())
    travel_mm = edmsim.Machine.load().base.table.travel_mm.value
    for said in (
        f"span {blocks.TABLE_MM:g} or less", f"span {blocks.LEAST_WHOLE_UM} or more",
        f"closes within {outline.JOIN_TOLERANCE_MM * 1e3:g} um", f"lead-in of {path.LEAD_IN_MM:g} mm",
        f"radius of {path.START_HOLE_RADIUS_MM:g} mm", f"extends {path.STOCK_MARGIN_MM:g} mm around",
        f"({travel_mm:g} x {travel_mm:g} mm on the default machine)",
    ):
        assert said in words


@pytest.mark.parametrize(
    "name", ["edmsim", "edmsim.controllers", "edmsim.envs", "edmsim.calibration", "edmsim.program"],
)  # fmt: skip
def test_every_public_name_has_an_entry(name):
    module = importlib.import_module(name)
    entries = "\n".join(file.read_text(encoding="utf-8") for file in (DOCS / "api").glob("*.rst"))
    for public in module.__all__:
        if not isinstance(getattr(module, public), ModuleType):
            assert re.search(rf"^\.\. auto\w+:: {public}$", entries, re.MULTILINE), public


def test_every_figure_for_a_paper_has_an_entry():
    entries = (DOCS / "api" / "figures.rst").read_text(encoding="utf-8")
    for found in pkgutil.iter_modules(figures.__path__, f"{figures.__name__}."):
        for name, value in vars(importlib.import_module(found.name)).items():
            drawn = name.endswith("_figure") and found.name != f"{figures.__name__}.style"  # which draws none itself
            if drawn and not name.startswith("_") and value.__module__ == found.name:
                assert f".. autofunction:: {name}\n" in entries, name
