"""Figures that several pages give are one figure."""

import re
from pathlib import Path

from edmsim.envs import registry

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NUMBERS = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def texts():
    """Every page as one line."""
    return {page.relative_to(ROOT).as_posix(): " ".join(page.read_text(encoding="utf-8").split()) for page in PAGES}


def test_pages_count_the_environments_that_there_are():
    there = set(registry.registered_ids())
    number = "|".join(NUMBERS)
    counts = re.compile(rf"({number}) (?:\[?Gymnasium\]?(?:\([^)]*\))? )(?:environments|tasks)", re.IGNORECASE)
    said = {(name, count.lower()) for name, text in texts().items() for count in counts.findall(text)}
    assert said == {("docs/environments.md", NUMBERS[len(there) - 1])}
    assert set(re.findall(r"\| \[`(edmsim/\w+-v\d)`\]", texts()["docs/environments.md"])) == there


def test_no_page_says_how_long_another_computer_compiles():
    spans = {
        (name, words) for name, text in texts().items() for sentence in re.split(r"(?<=[.:]) ", text)
        if "compil" in sentence and "pulse loop" in sentence
        for words in re.findall(r"(?:about |some )?(?:an?|\d+) (?:minutes?|s\b)(?: or two)?", sentence)
    }
    assert {name for name, _ in spans} <= {"docs/changelog.md", "docs/performance.md"}


def test_no_page_gives_the_pace_of_another_computer():
    pace = re.compile(r"times real time|(?:\w+ieth|\w+fth) of the time")
    assert {name for name, text in texts().items() if pace.search(text)} <= {"docs/changelog.md"}


def test_what_a_policy_earns_where_it_was_trained_is_that_of_the_benchmark():
    pages = (ROOT / "docs" / name for name in ("tasks/gap-feed.md", "benchmark.md"))
    task, benchmark = (page.read_text(encoding="utf-8") for page in pages)
    table = task.split("<!-- begin transfer -->")[1].strip().splitlines()
    names = re.findall(r"`([^`]+)`", table[0])
    cells = table[2].strip("| ").split(" | ")
    assert (cells[0], names[0]) == ("as trained", "policy:GapFeed-ppo")
    rows = benchmark.split("## edmsim/GapFeed-v2")[1].split("## ")[0].splitlines()
    for name, cell in zip(names, cells[1:], strict=True):
        (row,) = (line.split(" | ") for line in rows if line.startswith(f"| `{name}` "))
        assert cell.split("; ")[0] == row[6], name
