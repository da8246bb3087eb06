"""docs/controller-1982.md: every row of the thesis once, with the tests that quote it; every name on the page exists.

``python tests/test_controller_1982.py`` writes the tests again into the page.
"""

import ast
import importlib
import io
import re
import tokenize
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PAGE = TESTS.parent / "docs" / "controller-1982.md"
ROWS = [*(f"T-{n}" for n in range(1, 88)), *(f"T-G{n}" for n in range(1, 13)), *(f"T-A{n}" for n in range(1, 18))]
ROW = re.compile(r"^\| (T-[AG]?\d+) \| ([^|]*) \| ([^|]*) \|$", re.MULTILINE)
QUOTE = re.compile(r"#\s*T-[AG]?\d")
HEADING = "## Rows"
NAME = re.compile(r"`(edmsim(?:\.\w+)+)`")


@cache
def quoting_tests():
    """Tests by the row they quote: a comment that begins with a row, within the test or right above it."""
    found = defaultdict(list)
    for file in sorted(TESTS.rglob("test_*.py")):
        text = file.read_text(encoding="utf-8")
        if not QUOTE.search(text):
            continue
        lines = text.splitlines()
        spans = [
            (_first_line(node, lines), node.end_lineno or node.lineno, node.name)
            for node in ast.parse(text).body
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
        ]
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT and QUOTE.match(token.string):
                for begin, end, name in spans:
                    if begin <= token.start[0] <= end:
                        for row in re.findall(r"T-[AG]?\d+", token.string):
                            place = f"`{file.relative_to(TESTS).as_posix()}::{name}`"
                            if place not in found[row]:
                                found[row].append(place)
    return found


def _first_line(node, lines):
    """Number of the line on which a function begins, its decorators and the comment above them included."""
    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
    while first > 1 and lines[first - 2].startswith("#"):
        first -= 1
    return first


def table():
    """Lines of the page's table of rows: row, requirement, tests or reason."""
    return ROW.findall(PAGE.read_text(encoding="utf-8").split(HEADING)[1])


def refreshed(text):
    """Return the page with the current tests of every row; if a row has no tests, its reason is kept."""
    quoting = quoting_tests()

    def line(match):
        row, asks, last = match.groups()
        reason = "" if last.lstrip().startswith("`") else last
        return f"| {row} | {asks} | {'<br>'.join(quoting[row]) if row in quoting else reason} |"

    before, after = text.split(HEADING)
    return before + HEADING + ROW.sub(line, after)


def test_every_row_stands_there_once_and_in_order():
    assert [row for row, _, _ in table()] == ROWS


def test_no_row_is_without_a_test_or_a_reason():
    assert [row for row, asks, last in table() if not (asks and last.strip())] == []


@pytest.mark.slow
def test_the_tests_are_those_that_quote_the_row():
    text = PAGE.read_text(encoding="utf-8")
    assert text == refreshed(text), "run python tests/test_controller_1982.py"


@pytest.mark.slow
def test_a_quoted_row_exists():
    assert set(quoting_tests()) <= set(ROWS)


def test_every_name_of_the_page_is_there():
    names = set(NAME.findall(PAGE.read_text(encoding="utf-8")))
    assert len(names) > 40
    for name in names:
        parts = name.split(".")
        for cut in range(len(parts), 0, -1):
            try:
                found = importlib.import_module(".".join(parts[:cut]))
            except ModuleNotFoundError:
                continue
            for part in parts[cut:]:
                assert hasattr(found, part), name
                found = getattr(found, part)
            break


if __name__ == "__main__":
    PAGE.write_text(refreshed(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
