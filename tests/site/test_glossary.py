"""The glossary's names are those of the code."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in PAGE.splitlines() if line.startswith("| ")]
TERMS = [row for row in ROWS if row[0] != "term"]


def _words():
    files = [f for top in ("edmsim", "controllers", "envs", "models") for f in (ROOT / top).rglob("*")]
    texts = [f.read_text(encoding="utf-8") for f in files if f.suffix in (".py", ".toml")]
    return set(re.findall(r"[A-Za-z][\w-]*", "\n".join(texts)))


def test_every_name_of_the_glossary_occurs_in_the_code():
    words = _words()
    names = [name for row in TERMS for name in re.findall(r"`([^`]+)`", row[-1])]
    assert len(names) >= len(TERMS) > 40
    assert [name for name in names if name not in words] == []


def test_every_term_stands_once_with_a_meaning_and_a_source():
    terms = [row[0] for row in TERMS]
    assert len(set(terms)) == len(terms)
    assert all(len(row) == 6 and row[3] and row[4] for row in TERMS)
