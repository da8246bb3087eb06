"""Tables at any width: names are shortened and stay different, numbers stay complete. Progress in a file: lines."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from edmsim.screen import ScreenTable, shortened

LONG = ["/home/someone/runs/of/last/week/a/policy.json", "/home/someone/runs/of/last/week/b/policy.json",
        "counts", "counts:open_target_share=0.05,short_weight=0.75,integral_um_s2=21"]  # fmt: skip
NUMBERS = ["0.953", "1234.5", "10.5 %", "none (at most 3.2)", "-0.00457"]


def printed(table, width):
    console = Console(width=width, file=io.StringIO(), force_terminal=False)
    console.print(table)
    return console.file.getvalue().splitlines()


@pytest.mark.parametrize("width", [200, 80, 60, 45])
def test_numbers_stay_whole_and_names_different(width):
    table = ScreenTable("controller", numbers=("score", "mm2/min", "short", "breaks/m", "edge um rms"), box=None)
    for row, name in enumerate(LONG):
        table.add_row(name, *(f"{number}{row}" for number in NUMBERS))
    lines = printed(table, width)
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    for row in range(len(LONG)):
        of_row = [f"{number}{row}" for number in NUMBERS]
        assert all(number in text for number in of_row)
        holding = {line.split()[0] for line in lines if any(number in line for number in of_row)}
        assert len(holding) == 1  # the row has the same name in all parts of the table
    assert len({line.split()[0] for line in lines if "0.953" in line}) == len(LONG)
    assert (LONG[0] in text) == (width == 200)


def test_a_wide_enough_table_is_richs_own():
    table = ScreenTable("fact", numbers=("value",), title="facts")
    table.add_row("a sentence of some words", "1.0")
    assert "a sentence of some words" in "\n".join(printed(table, 40))
    assert "facts" in printed(table, 40)[0]


def test_sentences_wrap_and_heads_of_numbers_as_well():
    table = ScreenTable("place", numbers=["policy:/some/where/far/away/policy.json", "counts"])
    table.add_row("higher: 20 to 40 mm", "12.3 (10.1 to 15.2); 4.5; 0", "10.0 (8.0 to 12.2); 4.1; 1")
    text = "\n".join(printed(table, 60))
    assert "12.3 (10.1 to 15.2); 4.5; 0" in text
    assert "10.0 (8.0 to 12.2); 4.1; 1" in text
    assert all(word in text for word in ("higher:", "20", "40", "mm"))


def test_the_keys_of_a_row_are_repeated_where_the_table_goes_on():
    table = ScreenTable("height", "wire", numbers=["a" * 12, "b" * 12, "c" * 12], keys=2)
    table.add_row("5", "brass", "1.000000001", "2.000000002", "3.000000003")
    text = "\n".join(printed(table, 44))
    assert text.count("brass") == 3


@given(st.lists(st.text("abc/.", min_size=1, max_size=40), min_size=1, max_size=6), st.integers(1, 40))
def test_shortened_names_fit_and_differ(names, width):
    found = shortened(names, width)
    if found:
        assert set(found) == set(names)
        assert len(set(found.values())) == len(set(names))
        assert all(len(short) <= width for short in found.values())
        assert all(short == name for name, short in found.items() if len(name) <= width)


def test_what_differs_in_the_end_is_shortened_before_it():
    assert shortened(["/a/long/way/to/one", "/a/long/way/to/two"], 9) == {
        "/a/long/way/to/one": "/a/l…/one", "/a/long/way/to/two": "/a/l…/two"
    }  # fmt: skip
    assert shortened(["abcdefgh1", "abcdefgh2"], 1) == {}
