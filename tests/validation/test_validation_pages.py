"""The documentation: its tables are those of the constants, its proofs exist."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from edmsim import validation
from edmsim.errors import InputError
from edmsim.machine.components import Constant
from edmsim.machine.machine import Machine
from edmsim.validation.report import REASONS, as_json, failed, render_failed, rows_table
from edmsim.validation.rows import Row

ROOT = Path(__file__).parents[2]
THEORY = ROOT / "docs" / "theory"
PAGES = sorted(THEORY.glob("*.md"))
NO_PHYSICS = {
    "axes/drives", "axes/steps", "constants", "fleet", "kernel/memory",
    "kernel/state", "mechanics/engine", "plant", "resolution", "snapshot", "window",
}
ROWS = [
    Row.band("gap", "agrees", "Someone | 1982", low=1, simulated=2.0, unit="um"),
    Row.band("gap", "explained", "s", low=1, simulated=0.0, note="docs/theory/breakdown.md#flow"),
    Row.band("heat", "deviating", "s", low=1, simulated=0.0),
]


@pytest.fixture(scope="module")
def pages(load_script):
    return load_script(ROOT / "docs" / "make" / "validation.py")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_of_constants_are_up_to_date(pages, page):
    text = page.read_text(encoding="utf-8")
    assert pages.refreshed(text, page=page) == text, "run: python docs/make/validation.py"


def test_every_module_of_the_physics_has_a_page():
    index = (THEORY / "index.md").read_text(encoding="utf-8")
    table = "\n".join(line for line in index.splitlines() if line.startswith("| ["))
    plant = ROOT / "edmsim" / "plant"
    modules = {file.relative_to(plant).with_suffix("").as_posix() for file in plant.rglob("[!_]*.py")}
    assert modules >= NO_PHYSICS
    assert set(re.findall(r"`([\w/]+)\.py`", table)) == modules - NO_PHYSICS


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_proof_that_is_named_exists(page):
    text = page.read_text(encoding="utf-8")
    files = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")}
    tests = "\n".join(files.values())
    for name in re.findall(r"`(test_\w+)`", text):
        assert f"def {name}(" in tests or (f"{name}.py" in files), name
    table = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    for cell in re.findall(r"^\|.*\| ([^|]*\brows?\b[^|]*) \|$", text, re.MULTILINE):
        topical = "of topic" in cell
        for name in re.findall(r'"([^"]+)"', cell):
            expected = name.removesuffix(" ...")
            headings = re.search(rf"^## {re.escape(expected)}$", table, re.MULTILINE | re.IGNORECASE)
            assert f"| {expected}" in table or (topical and headings), name


def test_all_constants_of_all_files_stand_in_some_table():
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    machine = Machine.load()
    parts = [part for _, part in machine.base if not isinstance(part, str)]
    for part in [*parts, machine.wire, machine.material, machine.generator]:
        for name, constant in part:
            if isinstance(constant, Constant):
                assert f"`{name}` |" in text, name


def test_every_module_with_checks_takes_part():
    folder = Path(validation.__file__).parent
    modules = [path.stem for path in folder.glob("*.py") if path.stem != "__init__"]
    with_checks = {name for name in modules if hasattr(import_module(f"edmsim.validation.{name}"), "CHECKS")}
    assert with_checks == set(validation.MODULES)


def test_topics_of_checks_are_those_of_the_page():
    table = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    assert [heading.lower() for heading in re.findall(r"^## (.*)$", table, re.MULTILINE)[:-1]] == [*validation.TOPICS]
    assert all(validation.checks(topics=[topic]) for topic in validation.TOPICS)
    assert validation.checks(topics=validation.TOPICS) == validation.checks()


# --- making pages ---


def test_a_table_of_constants_has_value_range_and_source(pages):
    text = "a\n<!-- begin table: constants machine.gap -->\nFORMER\n<!-- end table -->\nb\n"
    new = pages.refreshed(text)
    assert "FORMER" not in new
    assert "| `critical_um` | 9 | 8 to 10 | Esteves et al." in new
    assert new.startswith("a\n<!-- begin table: constants machine.gap -->\n\n| constant |")
    assert new.endswith("\n\n<!-- end table -->\nb\n")
    assert pages.refreshed(new) == new


def test_tables_of_all_files_of_a_kind_name_the_file(pages):
    new = pages.refreshed("<!-- begin table: constants wire material generator -->\n<!-- end table -->")
    for start in ("brass `density_kg_m3` | 8400", "molybdenum `", "copper `", "tool-steel `", "iso-energetic `"):
        assert f"| {start}" in new


def test_tables_of_rows_wait_for_rows(pages):
    text = "<!-- begin table: rows gap -->\nold\n<!-- end table -->\n"
    assert pages.refreshed(text) == text
    new = pages.refreshed(text, ROWS)
    assert "| agrees | at least 1 um | 2 um | central value >= 1 um | agrees | Someone \\| 1982 |" in new
    assert "**fails**, [why](breakdown.md#flow)" in new
    assert "deviating" not in new


@pytest.mark.parametrize("mark", ["constants gape", "figures gap"])
def test_an_unknown_table_is_reported_with_its_page(pages, mark):
    text = f"<!-- begin table: {mark} -->\n<!-- end table -->"
    with pytest.raises(InputError, match=r"^wire\.md: no .*there are"):
        pages.refreshed(text, page=Path("wire.md"))


def test_the_page_of_all_rows_is_by_topic(pages):
    page = pages.validation_page(ROWS)
    assert "3 rows: 1 agree, 2 fail, 1 of them without an explanation." in page
    assert page.index("## Gap") < page.index("| explained |") < page.index("## Heat") < page.index("| deviating |")
    assert "[why](theory/breakdown.md#flow)" in page
    assert rows_table(ROWS)[-1].split(" | ")[4] == "**fails**"


def test_rows_that_do_not_count_are_listed_with_their_reason(pages):
    rows = [ROWS[0], ROWS[2].context("another | material"), ROWS[1].calibration("the flux")]
    page = pages.validation_page(rows)
    assert "0 of them without an explanation; 1 of calibration (failing: 1) and 1 of context do not count" in page
    assert "| deviating | heat | context | another \\| material |" in page
    assert "| explained | gap | calibration | the flux |" in page
    assert [line.split(" | ")[4] for line in rows_table(rows)[3:]] == ["context", "calibration: fails"]
    assert "## Rows that do not count" not in pages.validation_page(ROWS[:1])


def test_writing_refreshes_the_theory_and_makes_the_page(pages, tmp_path):
    (tmp_path / "theory").mkdir()
    page = tmp_path / "theory" / "x.md"
    page.write_text("<!-- begin table: rows heat -->\n<!-- end table -->\n", encoding="utf-8")
    pages.write(tmp_path, ROWS)
    assert "| deviating |" in page.read_text(encoding="utf-8")
    assert (tmp_path / "validation.md").read_text(encoding="utf-8") == pages.validation_page(ROWS)


@pytest.mark.parametrize(("rows", "status"), [(ROWS[:2], 0), (ROWS, 1)])
@pytest.mark.parametrize("json", [True, False])
def test_only_a_failure_nobody_explains_fails_the_command(rows, status, json, monkeypatch, edmsim):
    monkeypatch.setattr(validation, "run", lambda watch, **_: rows)
    shown = edmsim("validate", *(["--json"] if json else []))
    assert shown.status == status
    said = [r"ok\W+agrees", r"fails\W+explained", *[r"FAILS\W+deviating"] * status]
    assert '"agree": 1' in shown.out if json else all(re.search(words, shown.out) for words in said)


def test_every_row_that_fails_has_a_reason_in_a_sentence():
    table = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    failing = set()
    for section in re.split(r"^## ", table, flags=re.MULTILINE)[1:]:
        topic = section.splitlines()[0].lower()
        failing |= {(topic, anchor) for anchor in re.findall(r"\*\*fails\*\*, \[why\]\([^#]*#([\w-]+)\)", section)}
    assert failing == set(REASONS)


def test_what_fails_fits_a_terminal_of_eighty_columns():
    from rich.console import Console

    name, note = "a row with a long name, " * 6, "docs/theory/emergence.md#lag"
    long = Row.band("lag", name, "s", low=1, simulated=0.0, note=note)
    console = Console(width=80, record=True)
    with console.capture() as shown:
        console.print(render_failed([*ROWS, long]))
    text = shown.get()
    assert max(map(len, text.splitlines())) <= 80
    for said in ("why: unknown", "why: The push of the", "4 rows: 1 agree, 3 fail"):
        assert said in text
    assert "agrees\n" not in text
    document = as_json(ROWS, failed(ROWS))
    assert '"agree": 1' in document
    assert '"agrees"' not in document


@pytest.mark.parametrize(
    ("words", "said"),
    [("--topics wire,nonsense", "unknown topic 'nonsense'; there are: ignition"),
     ("--out FOLDER/checks.txt", "a table of checks is written as .jsonl"),
     ("--out FOLDER/leaderboard.jsonl", "leaderboard.jsonl:1: the journal is damaged")],
)  # fmt: skip
def test_a_wrong_option_is_refused_before_the_first_check(words, said, monkeypatch, tmp_path, edmsim):
    monkeypatch.setattr(validation, "run", lambda *_, **__: pytest.fail("checks were run"))
    (tmp_path / "leaderboard.jsonl").write_text('{"id": "x", "controller": "counts"}\n')
    shown = edmsim("validate", *words.replace("FOLDER", str(tmp_path)).split())
    assert (shown.status, said in shown.err) == (2, True)
