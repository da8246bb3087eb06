"""docs/architecture.md: read in ten minutes; its files, names and order of packages are those of the code."""

import ast
import re
from functools import cache

import pytest

from tests.test_house import ORDER, ROOT

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
MOST_WORDS = 2300  # ten minutes at 230 words a minute
ROWS = [
    [cell.strip() for cell in line.strip("|").split(" | ")] for line in PAGE.splitlines() if line.startswith("| ")
]


@cache
def defined(file):
    """Names that a file defines, and those within its classes behind a point."""
    found = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        for name in names(node):
            found.add(name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{name}" for inner in node.body for name in names(inner)}
    return found


def names(node):
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
        case ast.Assign(targets=targets):
            return [target.id for target in targets if isinstance(target, ast.Name)]
    return []


def test_it_is_read_in_ten_minutes():
    assert len(PAGE.split()) <= MOST_WORDS


def finds():
    """Names that the page says are in a file: "`erode` in `edmsim/plant/kernel/discharge.py`"."""
    found = re.findall(r"((?:`[\w.]+`(?:, | and |))+)(?: and others)? in `([\w/]+\.py)`", PAGE)
    found += [(f"`{name}`", file) for name, file in re.findall(r"`([\w.]+)`\s+\(`([\w/]+\.py)`\)", PAGE)]
    return [(name, file) for together, file in found for name in re.findall(r"`([\w.]+)`", together)]


def test_every_name_is_defined_in_the_file_that_the_page_says():
    assert {name for name, _ in finds()} >= {
        "distribute_crater", "CutSettings", "Choices", "control", "ObservationBuilder", "MEASURED",
        "Simulation.restore", "Report",
    }  # fmt: skip
    for name, file in finds():
        assert name in defined(ROOT / file), f"{name} is not in {file}"


@pytest.mark.parametrize("question", [
    "where is a spark's crater made?", "where is an option declared?", "where is a UHU's law?",
    "where is the observation of an environment built?", "what does `--resume` restore?",
    "how is a figure of the report computed?", "where does the offset of a trim come from?",
    "where is the unit of a program decided?", "where is the exchange with FMUs?",
    "where is a task's reward declared?",
])  # fmt: skip
def test_what_a_newcomer_looks_for_has_a_file_and_a_name(question):
    (answer,) = [cells[1] for cells in ROWS if cells[0] == question]
    assert any(file in answer and f"`{name}`" in answer for name, file in finds())


def test_packages_are_in_the_order_in_which_they_import_each_other():
    table = PAGE.split("| package or file | subject |")[1].split("\n\n")[0]
    paths = re.findall(r"^\| `([\w/.]+)`", table, re.MULTILINE)
    packages = [re.sub(r"^edmsim/|/$|\.py$", "", path) for path in paths]
    assert packages == [name for name in ORDER if name not in ("", "__main__")]
