"""docs/performance.md: its tables are those that its script writes."""

from pathlib import Path

import numpy as np
import pytest

from edmsim.bench.profile import PARTS, PROFILED, LoopProfile
from edmsim.bench.revisions import Pairs

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "performance.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def script(load_script):
    return load_script(DOCS / "make" / "performance.py")


def section(name):
    """Cells of the table between two marks of the page."""
    lines = PAGE.split(f"<!-- begin {name} -->")[1].split(f"<!-- end {name} -->")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]


def test_the_parts_of_the_page_add_up(script):
    head, _, *rows, together = section("parts")
    assert head == ["part", *(f"`{name}`, {unit}" for name in PROFILED for unit in ("ns", "%"))]
    assert [name for name, *_ in rows] == list(PARTS)
    for column, total in enumerate(together[1:], 1):
        assert sum(int(row[column]) for row in rows) == pytest.approx(int(total), abs=len(rows) / 2)


def test_the_ratios_of_the_page_are_those_that_are_measured(script):
    head, _, *rows = section("pairs")
    assert script.AGAINST in head[1]
    assert [name for name, *_ in rows] == list(script.NAMES.values())


def test_the_script_writes_shares_and_ratios(script):
    shares = dict(zip(PARTS, [0.55, *[0.05] * 9], strict=True))
    lines = script.parts({"fast": LoopProfile(400.0, 420.0, shares, 21_000)}).splitlines()
    assert "| ray sums | 220 | 55 |" in lines
    assert "| together | 400 | 100 |" in lines
    assert "21,000 samples. In the loop compiled for sampling a pulse took 1.05 times as long." in lines[-1]
    rates = dict.fromkeys(script.NAMES, np.array([10.0, 12.0, 39.0]))
    before = dict.fromkeys(script.NAMES, np.full(3, 10.0))
    lines = script.pairs(Pairs("a80349b313", rates, before), (0.9, 2.5)).splitlines()
    assert "| pulses at `fast` | 1.20 | 1.00 to 3.90 |" in lines
    assert lines[-1].startswith("3 pairs on ")
    assert "load average of 0.9 before and 2.5 after" in lines[-1]
