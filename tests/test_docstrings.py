"""Docstrings of internals, which are not in the reference, have one to three lines; few of them are longer."""

import ast
import re
from typing import NamedTuple

import pytest

from .test_house import ROOT, modules, place, tree

PAGES = "\n".join(file.read_text(encoding="utf-8") for file in (ROOT / "docs" / "api").glob("*.rst"))
NAMED = set(re.findall(r"auto(?:class|function|exception):: (?:\w+\.)*(\w+)", PAGES))
WITH_MEMBERS = set(re.findall(r"autoclass:: (?:\w+\.)*(\w+)\n +:members:", PAGES))
LONGEST, LONG_SHARE = 3, 0.1
"""Greatest number of lines of an internal docstring, and the share of longer ones that is allowed."""


class Documented(NamedTuple):
    place: str
    text: str
    lines: int


def internals():
    """Docstrings of functions, classes and methods that are not in the reference."""

    def within(body, file, owner, listed):
        for node in body:
            if not isinstance(node, ast.FunctionDef | ast.ClassDef):
                continue
            public = listed and not node.name.startswith("_") if owner else node.name in NAMED
            text = ast.get_docstring(node)
            if text is not None and not public:
                first = node.body[0]
                assert first.end_lineno is not None
                yield Documented(f"{file}:{node.lineno}: {node.name}", text, first.end_lineno - first.lineno + 1)
            if isinstance(node, ast.ClassDef):
                yield from within(node.body, file, node.name, node.name in WITH_MEMBERS)

    for name, file in modules().items():
        yield from within(tree(name).body, place(file), "", False)


@pytest.mark.slow
def test_few_internals_have_long_docstrings():
    lines = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in modules().values())
    long = sum(doc.lines for doc in internals() if doc.lines > LONGEST)
    assert long < LONG_SHARE * lines, f"{long} of {lines} lines"
