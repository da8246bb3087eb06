"""The input routines of 1982: LINE with its corrections, NORMAL, GNUMCI, GETNUM, GNUMHX and SKIP."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from edmsim.consoles.computer_1982.line_input import (
    InputBuffer,
    Line,
    getnum,
    gnumci,
    gnumhx,
    normal,
    skip,
)
from edmsim.controllers.mcu.firmware.memory_map import LINE_LENGTH
from edmsim.errors import InputError


def type_in(keys):
    """Lines given away while some characters were typed, and everything echoed."""
    buffer, echoed, lines = InputBuffer(), bytearray(), []
    line = Line(buffer, echoed.extend)
    for key in keys:
        if line.take(key):
            lines.append(buffer.text)
    return lines, bytes(echoed)


# T-53: nothing before a terminator; CR and LF are the terminators (T-A10)
@pytest.mark.parametrize("terminator", [b"\r", b"\n"])
def test_a_line_is_delivered_at_its_terminator_only(terminator):
    assert type_in(b"START") == ([], b"START")
    assert type_in(b"START" + terminator) == ([b"START"], b"START\r\n")


def test_the_screen_shows_what_the_line_holds():
    assert type_in(b"AC\x08B")[1] == b"AC\b \bB"
    assert type_in(b"ABC\x18")[1] == b"ABC" + 3 * b"\b \b"
    assert type_in(b"ABC\x12")[1] == b"ABC\r\nABC"  # Ctrl-R types it again


def test_the_65th_character_rings_and_the_line_is_not_delivered():
    buffer, echoed = InputBuffer(b"OLD"), bytearray()
    line = Line(buffer, echoed.extend)
    for _ in range(LINE_LENGTH + 1):
        assert not line.take(ord("1"))
    assert echoed == b"1" * LINE_LENGTH + b"\x07"
    with pytest.raises(InputError, match="at most 64 characters"):
        line.take(0x0D)
    assert buffer.text == b""
    assert line.typed == b""


@pytest.mark.parametrize("key", [0x01, 0x1B, 0x80, 0xE9])
def test_what_is_no_character_of_the_terminal_rings(key):
    assert type_in(bytes([key]) + b"POS\r") == ([b"POS"], b"\x07POS\r\n")


# T-54
def test_normal_makes_capitals_and_changes_nothing_else():
    every = bytes(range(256))
    changed = {(a, b) for a, b in zip(every, normal(every), strict=True) if a != b}
    assert changed == {(ord(c), ord(c.upper())) for c in "abcdefghijklmnopqrstuvwxyz"}
    assert type_in(b"new 10,20\r")[0] == [b"NEW 10,20"]


# T-55
def test_gnumci_gives_the_characters_and_then_spaces():
    buffer = InputBuffer(b"AB")
    assert [gnumci(buffer) for _ in range(4)] == [ord("A"), ord("B"), 0x20, 0x20]
    assert buffer.waiting == 0


# T-56, T-60
@given(st.integers(0, 65_535), st.sampled_from([b"", b" 7", b",", b"X", b"H"]))
def test_numbers_of_16_bits_are_read_and_the_pointer_ends_after_them(value, after):
    for routine, written in ((getnum, b"%d" % value), (gnumhx, b"%X" % value)):
        buffer = InputBuffer(written + after)
        assert routine(buffer) == value
        assert buffer.rest == after


@pytest.mark.parametrize(("routine", "text", "reason"), [
    (getnum, b"65536,1", "a number has 16 bits, 0..65535, not 65536"),
    (getnum, b"99999999999999999999,1", "a number has 16 bits"),
    (gnumhx, b"10000,1", "a number has 16 bits, 0..FFFF, not 10000"),
])  # fmt: skip
def test_numbers_past_16_bits_are_refused_and_passed(routine, text, reason):
    buffer = InputBuffer(text)
    with pytest.raises(InputError, match=reason):
        routine(buffer)
    assert buffer.rest == b",1"


@pytest.mark.parametrize(
    ("routine", "text", "found"), [(getnum, b"X1", "X"), (gnumhx, b"G", "G"), (getnum, b"", "the end of the line")]
)
def test_what_is_no_number_is_refused_where_it_stands(routine, text, found):
    buffer = InputBuffer(text)
    with pytest.raises(InputError, match=f"is expected at column 1, not {found}"):
        routine(buffer)
    assert buffer.rest == text


# T-57
@pytest.mark.parametrize(("text", "carry", "rest"), [
    (b"", False, b""), (b" ,;= ", False, b""), (b"  ,X", True, b"X"), (b"X ", True, b"X "), (b"-5", True, b"-5"),
])  # fmt: skip
def test_skip_passes_separators_and_tells_by_its_carry_whether_a_character_waits(text, carry, rest):
    buffer = InputBuffer(text)
    assert skip(buffer) is carry
    assert buffer.rest == rest


@given(st.lists(st.integers(0, 65_535), max_size=10))
def test_a_line_of_numbers_is_read_back_by_skip_and_getnum(numbers):
    buffer = InputBuffer(b" , ".join(b"%d" % n for n in numbers))
    found = []
    while skip(buffer):
        found.append(getnum(buffer))
    assert found == numbers


# T-53, T-A10: whatever is typed and corrected, the line is what a list would hold
@example([ord("A")] * LINE_LENGTH)
@example([*b"SPEEF\x08D 9"])
@example([*b"A"] * LINE_LENGTH + [*b"BC\x08D"])
@given(st.lists(st.one_of(st.sampled_from([0x08, 0x7F, 0x18, 0x12]), st.integers(0x20, 0x7E)), max_size=150))
def test_corrections_are_those_of_a_list_of_64(keys):
    held = []
    too_long = False
    for key in keys:
        if key == 0x18:
            held, too_long = [], False
        elif key in (0x08, 0x7F):
            held, too_long = held[:-1], False
        elif key != 0x12 and len(held) < LINE_LENGTH:
            held.append(key)
        elif key != 0x12:
            too_long = True
    if too_long:
        with pytest.raises(InputError):
            type_in(bytes(keys) + b"\r")
    else:
        assert type_in(bytes(keys) + b"\r")[0] == [bytes(held).upper()]
