"""The product has no code that only tests use: all definitions are used by the product, its pages or examples."""

import ast
import re
from typing import NamedTuple

import pytest

from .test_house import ROOT, modules, place, tree

OTHERS = ("docs", "examples", "notebooks", "models", "README.md", "pyproject.toml", "Makefile")
"""Folders and files that use the product, besides itself."""
REASONS = {
    "EdmsimGap": "the FMU's runtime finds the class by its file",
    "VectorEnv": "the classes of vector environments are registered by the name of their task",
    "_repr_html_": "notebooks show a result by it", "_repr_png_": "notebooks show a figure by it",
}  # fmt: skip
"""Names, or ends of names, that appear nowhere else, and what calls them."""
PLAIN = {
    "abstractmethod", "cache", "cached_property", "classmethod", "compiled", "contextmanager", "dataclass",
    "exactly_compiled", "final", "lru_cache", "override", "property", "record", "runtime_checkable", "sample",
    "staticmethod", "total_ordering",
}  # fmt: skip
"""Decorators that do not register a function."""
WORD = re.compile(r"\w+")
SHORT = 80
"""Greatest length of a string that may be a name that is looked up."""


class Definition(NamedTuple):
    names: tuple[str, ...]
    file: str
    line: int
    owner: ast.ClassDef | None


def decorators(node):
    for found in node.decorator_list:
        called = found.func if isinstance(found, ast.Call) else found
        yield called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def definitions(body, file, owner):
    """Functions, classes, methods and a module's constants; an assignment to several names counts as one."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            if set(decorators(node)) <= PLAIN:
                yield Definition((node.name,), file, node.lineno, owner)
            if isinstance(node, ast.ClassDef):
                yield from definitions(node.body, file, node)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and owner is None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
            yield Definition(tuple(names), file, node.lineno, None)
        elif isinstance(node, ast.If | ast.Try):
            yield from definitions(node.body, file, owner)


def mentions(module):
    """Every name that is read, imported under another name, or may be looked up by a string."""
    for node in ast.walk(module):
        match node:
            case ast.Name(id=name, ctx=ast.Load()) | ast.Attribute(attr=name, ctx=ast.Load()):
                yield name
            case ast.alias(name=name, asname=str()):
                yield name
            case ast.Constant(value=str(text)) if len(text) < SHORT:
                yield from WORD.findall(text)


def of_others():
    found = set()
    for name in OTHERS:
        folder = ROOT / name
        for file in [folder] if folder.is_file() else folder.rglob("*"):
            if file.suffix in (".py", ".md", ".rst", ".toml") or file.name == "Makefile":
                found.update(WORD.findall(file.read_text(encoding="utf-8")))
    return found


def documented():
    """Classes whose members are part of the reference, and the bases of these."""
    pages = "\n".join(file.read_text(encoding="utf-8") for file in (ROOT / "docs" / "api").glob("*.rst"))
    shown = set(re.findall(r"^\.\. autoclass:: (?:\w+\.)*(\w+)\n +:members:", pages, re.MULTILINE))
    classes = {
        node.name: node for name in modules() for node in ast.walk(tree(name)) if isinstance(node, ast.ClassDef)
    }
    waiting = list(shown)
    while waiting:
        for base in bases(classes.get(waiting.pop())):
            if base not in shown:
                shown.add(base)
                waiting.append(base)
    return shown


def bases(node):
    return [] if node is None else [ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases]


@pytest.mark.slow
def test_nothing_is_reached_by_tests_alone():
    used = {name for module in modules() for name in mentions(tree(module))} | of_others()
    shown = documented()
    own = {node.name for name in modules() for node in ast.walk(tree(name)) if isinstance(node, ast.ClassDef)}
    unused = []
    for name, path in modules().items():
        for found in definitions(tree(name).body, place(path), None):
            if used & set(found.names) or not found.names or found.names[0].startswith("__"):
                continue
            if any(each.endswith(end) for each in found.names for end in REASONS):
                continue
            if found.owner is not None and (
                (found.owner.name in shown and not found.names[0].startswith("_"))
                or set(bases(found.owner)) - own  # a library calls it
            ):
                continue
            unused.append(f"{found.file}:{found.line}: {', '.join(found.names)}")
    assert not unused, "\n".join(unused)


def test_the_reasons_have_a_use():
    found = [each for module in modules() for each in definitions(tree(module).body, "", None)]
    names = {name for each in found for name in each.names}
    assert [end for end in REASONS if not any(name.endswith(end) for name in names)] == []
