"""The structure of the code: packages, imports between them, length of files, and unique names."""

import ast
import re
import tomllib
from collections import Counter, defaultdict
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "edmsim": ROOT / "edmsim", "edmsim.controllers": ROOT / "controllers", "edmsim.envs": ROOT / "envs",
    "edmsim.models": ROOT / "models",
}  # fmt: skip
LINKS = ("controllers", "envs", "models")
MOST_LINES = 800
FEWEST_FILES = 4
MOST_IMPORTS = 0.05
CALL_ALL = {"cli": 0.09, "bench": 0.07}
"""Packages that call or measure every other one, each by an import of its own, and their shares of imports."""
LAYERS: dict[str, set[str]] = {
    "compiled": {"compiled"}, "errors": set(), "numeric": {"errors"},
    "machine": {"machine", "errors", "numeric", "models", "files"},
    "models": {"models", "errors"},
    "plant": {"plant", "errors", "numeric", "machine", "models", "compiled"},
    "controllers": {
        "controllers", "errors", "numeric", "snapshots", "machine", "models", "geometry", "files", "user_code",
        "compiled",
    },
}  # fmt: skip
"""Packages that may import only some others."""
ORDER = (
    "models", "compiled", "errors", "numeric", "snapshots", "files", "user_code", "screen", "signals",
    "runs", "geometry", "machine", "plant", "controllers", "axis_bench", "program", "metrology", "closed_loop",
    "recording", "job", "measure", "envs", "consoles", "hil", "evaluation", "learning", "calibration", "validation",
    "sweep", "bench", "cli", "", "__main__",
)  # fmt: skip
"""Packages and single files from the bottom up: each imports only from those before it."""


@cache
def modules():
    """Every Python file of the product by the name of its module."""
    found = {}
    for package, folder in FOLDERS.items():
        for file in sorted(folder.rglob("*.py")):
            parts = file.relative_to(folder).with_suffix("").parts
            if package != "edmsim" or parts[0] not in LINKS:
                found[".".join([package, *parts]).removesuffix(".__init__")] = file
    return found


def place(file):
    return file.relative_to(ROOT).as_posix()


@cache
def parsed(file):
    return ast.parse(file.read_text(encoding="utf-8"))


def tree(name):
    return parsed(modules()[name])


@cache
def imports(name):
    """Modules of the product that a module imports anywhere, also only for types; without `edmsim` itself."""
    imported = set()
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                imported.add(inner if inner in modules() else str(node.module))
    return frozenset(imported & modules().keys()) - {name, "edmsim"}


def package(name):
    return (name + ".").split(".")[1]


def test_the_packages_are_the_folders():
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    folders = {name for name, file in modules().items() if file.name == "__init__.py"}
    assert set(setuptools["packages"]) == folders
    assert setuptools["packages"] == sorted(folders)
    assert {name: ROOT / folder for name, folder in setuptools["package-dir"].items()} == FOLDERS
    bare = {file.parent for file in modules().values()} - {modules()[name].parent for name in folders}
    assert not bare, "a folder with Python files needs an __init__.py"


def test_packages_import_only_what_lies_below_them():
    assert [
        f"{name} imports {other}"
        for name in modules() if package(name) in LAYERS
        for other in imports(name) if package(other) not in LAYERS[package(name)]
    ] == []  # fmt: skip


def test_nobody_imports_the_command_line():
    users = [name for name in modules() if any(package(other) == "cli" for other in imports(name))]
    assert [name for name in users if package(name) not in ("cli", "__main__")] == []


def test_every_package_imports_only_from_those_below_it():
    upward = {
        f"{name} imports {other}"
        for name in modules() for other in imports(name) if ORDER.index(package(other)) > ORDER.index(package(name))
    }  # fmt: skip
    assert upward == {"edmsim.models imports edmsim.errors"}  # errors import nothing


def test_recording_makes_no_plant():
    simulates = {"Plant", "Fleet", "Simulation", "Cycle", "Traverse", "sample_pulses", "sample_like", "cut"}
    assert [
        name for name in modules() if package(name) == "recording" for node in ast.walk(tree(name))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("edmsim.")
        if not node.module.startswith("edmsim.recording") and simulates & {alias.name for alias in node.names}
    ] == []  # fmt: skip


def test_no_files_import_each_other_in_a_circle():
    def reach(start):
        visited = set()
        new = set(imports(start))
        while new:
            visited |= new
            new = set().union(*(imports(name) for name in new)) - visited
        return visited

    reached = {name: reach(name) for name in modules()}
    assert {
        " ".join(sorted(other for other in reached[name] if name in reached[other]))
        for name in modules() if name in reached[name]
    } == set()  # fmt: skip


def test_constants_of_a_machine_stand_under_models():
    """The travel of the table, 65 mm, and its middle, in any unit."""
    travel = {65_000, 32_500, 65.0, 32.5, 0.065, 0.0325}
    broken = {
        place(modules()[name]) for name in modules() for node in ast.walk(tree(name))
        if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value in travel
    }  # fmt: skip
    assert broken == {"edmsim/program/blocks.py"}  # a rule for reading programs (row T-61), for all machines


def test_a_public_class_has_a_name_of_its_own_in_its_package():
    places = defaultdict(list)
    for name in modules():
        for node in tree(name).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[package(name), node.name].append(name)
    assert [f"{where}: {name}" for (where, name), found in places.items() if len(found) > 1] == []


def test_files_are_not_too_long():
    files = modules().values()
    assert [place(file) for file in files if len(file.read_text(encoding="utf-8").splitlines()) > MOST_LINES] == []


def test_imports_are_at_most_a_twentieth_of_the_lines_of_a_package():
    lines, imported = Counter(), Counter()
    for name, file in modules().items():
        room = "" if file.parent == FOLDERS["edmsim"] else package(name)  # single files count together
        lines[room] += len(file.read_text(encoding="utf-8").splitlines())
        imported[room] += len({
            line for node in ast.walk(tree(name)) if isinstance(node, ast.Import | ast.ImportFrom)
            for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
        })  # fmt: skip
    del lines["models"]  # a single file
    assert [
        f"{room}: {imported[room]} of {lines[room]}" for room in lines
        if imported[room] > CALL_ALL.get(room, MOST_IMPORTS) * lines[room]
    ] == []  # fmt: skip


def test_a_folder_holds_several_files():
    files = [file for file in modules().values() if file.name != "__init__.py"]
    data = {ROOT / "models"}  # it has the tables of the machines, and no code
    folders = {file.parent for file in modules().values()} - data
    few = [folder for folder in folders if sum(folder in file.parents for file in files) < FEWEST_FILES]
    assert few == []


@pytest.mark.parametrize("package", FOLDERS)
def test_every_file_says_first_what_it_is(package):
    for name, file in modules().items():
        if file.is_relative_to(FOLDERS[package]):
            said = (ast.get_docstring(tree(name)) or "").split("\n")[0]
            assert re.search(r"\w.*[.:]$", said), f"{place(file)} begins with {said!r}"
