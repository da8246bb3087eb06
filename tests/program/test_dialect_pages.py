"""The pages of the dialects: their programs can be read, and their tables list the words that the code accepts."""

import re
from pathlib import Path

import pytest

from edmsim.program.dialects import DIALECTS
from edmsim.program.gcode_outlines import read_gcode
from edmsim.program.tables import SETTINGS

DOCS = Path(__file__).parents[2] / "docs" / "dialects"
NAMES = sorted(set(DIALECTS) - {"iso"})
PASSES = {"index": 2, "sodick": 2, "mitsubishi": 2, "skd2": 2, "fanuc": 2}
TAPERED = {"sodick", "fanuc", "charmilles", "linuxcnc"}


def first_cells(page):
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    return "\n".join(re.split(r" \| ", row)[0] for row in rows)


@pytest.mark.parametrize("name", [*NAMES, "index"])
def test_the_program_of_a_page_is_read_as_its_dialect(name, tmp_path):
    (text,) = re.findall(r"```text\n(.*?)```", (DOCS / f"{name}.md").read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "part.nc").write_text(text)
    offsets = {"D1": 0.195} if name == "charmilles" else {}
    program = read_gcode(tmp_path / "part.nc", offsets=offsets)
    assert program.dialect == ("sodick" if name == "index" else name)
    assert len(program.outlines) == PASSES.get(name, 1)
    assert all((outline.taper is not None) == (name in TAPERED) for outline in program.outlines)
    assert [outline.continues for outline in program.outlines] == [False, *[True] * (PASSES.get(name, 1) - 1)]


@pytest.mark.parametrize("name", NAMES)
def test_a_page_names_the_words_of_its_dialect(name):
    dialect = DIALECTS[name]
    cells = first_cells((DOCS / f"{name}.md").read_text(encoding="utf-8"))
    if name != "freecad":  # its table lists the switches of the post-processor
        codes = {f"{letter}{number:g}" for letter, number in dialect.codes}
        common = {"M98", "M99", "G2", "G3", "G4", "T1"}  # words of all dialects, and the angle T1.5
        assert set(re.findall(r"[GMT]\d+", cells)) - common == codes
        for letter in {*dialect.condition, *dialect.letters}:
            assert re.search(rf"\b{letter}(\d|,|\b)", cells), letter
        assert (":" in cells) == (dialect.upper == "colon")
        assert ("TP" in cells) == dialect.planes
        assert ("G4" in cells) == dialect.dwells_in_ms


def test_the_index_names_every_dialect_and_every_setting():
    page = (DOCS / "index.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| \[?`(\w+)`\]?", page.split("## Which")[0], re.MULTILINE)) == set(DIALECTS)
    table = page.split("| setting")[1].split("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", "\n".join(row.split(" | ")[0] for row in table.splitlines()))) == set(SETTINGS)
