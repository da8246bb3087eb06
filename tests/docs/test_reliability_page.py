"""What docs/reliability.md names: every test there is one, and every fault has its test or says that it has none."""

import re

import pytest

from .pages import ROOT, read

PAGE = "docs/reliability.md"
TESTS = "\n".join(file.read_text(encoding="utf-8") for file in (ROOT / "tests").rglob("test_*.py"))


@pytest.mark.parametrize("named", sorted(set(re.findall(r"`(test_\w+)`", read(PAGE)))))
def test_a_test_that_is_named_exists(named):
    assert f"\ndef {named}(" in TESTS


def test_every_fault_has_a_test_or_says_that_it_is_not_simulated():
    faults = read(PAGE).split("## Faults of the machine")[1]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in faults.splitlines() if line[:2] == "| "]
    rows = [row for row in rows[1:] if row[1]]  # the others are headings
    assert len(rows) > 40
    for fault, does, test in rows:
        assert re.search(r"`test_\w+`", test) or (test == "none" and does.startswith("not simulated")), fault
