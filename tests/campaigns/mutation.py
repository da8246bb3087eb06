"""Bad inputs made of good ones: the n-th input of a reader follows from seed, reader and n alone."""

import io
import random
import re
import zipfile
from collections.abc import Callable, Sequence

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"0", b"-0", b"1", b"-1", b"0.1", b"255", b"256", b"32767", b"32768", b"-32769", b"65536", b"2147483648",
    b"4294967296", b"-9223372036854775809", b"18446744073709551616", b"1e20", b"-1e300", b"1e400", b"1e-320", b"nan",
    b"inf", b"-inf", b"9" * 320, b"0." + b"0" * 330 + b"1", b"0x7f", b"1_0", b"1e", b"--1", b"1.2.3", b"\xd9\xa1",
)  # fmt: skip
"""Numbers that readers stumble over: ends of types, too small, too large, none, in other scripts."""
BYTES = b"\x00\x07\x0a\x0d\x1a\x1b\x20\x22\x27\x2c\x3b\x7f\x80\xc3\xfe\xff"
LARGEST = 60_000
"""Bytes of an input (ours: what is larger is found to be so at once)."""

Mutation = Callable[[random.Random, bytes, Sequence[bytes], Sequence[bytes]], bytes]


def mutated(draw: random.Random, corpus: Sequence[bytes], words: Sequence[bytes]) -> bytes:
    """Return an input: one of the corpus, changed some times."""
    data = draw.choice(corpus)
    kinds = ARCHIVE if data[:2] == b"PK" else TEXT if _is_text(data) else BINARY
    for _ in range(1 + int(min(draw.expovariate(0.6), 20))):
        data = draw.choice(kinds)(draw, data, corpus, words)[:LARGEST]
    return data


def _is_text(data: bytes) -> bool:
    return b"\x00" not in data[:1000]


def _span(draw: random.Random, data: bytes) -> tuple[int, int]:
    begin = draw.randrange(len(data) + 1)
    return begin, min(begin + 1 + int(min(draw.expovariate(0.15), 1000)), len(data))


def number(draw: random.Random, data: bytes, _corpus: Sequence[bytes], _words: Sequence[bytes]) -> bytes:
    """Put another number in the place of one."""
    found = list(NUMBER.finditer(data))
    if not found:
        return data + draw.choice(NUMBERS)
    place = draw.choice(found)
    put = draw.choice(NUMBERS) if draw.random() < 0.6 else repr(draw.uniform(-1e3, 1e3)).encode()
    return data[: place.start()] + put + data[place.end() :]


def word(draw: random.Random, data: bytes, _corpus: Sequence[bytes], words: Sequence[bytes]) -> bytes:
    """Put a word of the language somewhere."""
    begin, end = _span(draw, data)
    return data[:begin] + draw.choice(words or NUMBERS) + data[begin if draw.random() < 0.7 else end :]


def lines(draw: random.Random, data: bytes, _corpus: Sequence[bytes], _words: Sequence[bytes]) -> bytes:
    """Leave a line out, repeat it, or put it elsewhere."""
    rows = data.split(b"\n")
    row = rows.pop(draw.randrange(len(rows)))
    for _ in range(draw.choice((0, 0, 1, 2, 40))):
        rows.insert(draw.randrange(len(rows) + 1), row)
    return b"\n".join(rows)


def flipped(draw: random.Random, data: bytes, _corpus: Sequence[bytes], _words: Sequence[bytes]) -> bytes:
    """Change a byte."""
    if not data:
        return bytes([draw.randrange(256)])
    at = draw.randrange(len(data))
    put = draw.choice(BYTES) if draw.random() < 0.5 else data[at] ^ (1 << draw.randrange(8))
    return data[:at] + bytes([put]) + data[at + 1 :]


def cut_out(draw: random.Random, data: bytes, _corpus: Sequence[bytes], _words: Sequence[bytes]) -> bytes:
    """Leave something out, at times all that follows."""
    begin, end = _span(draw, data)
    return data[:begin] + (b"" if draw.random() < 0.1 else data[end:])


def repeated(draw: random.Random, data: bytes, _corpus: Sequence[bytes], _words: Sequence[bytes]) -> bytes:
    """Repeat something, at times many times: brackets within brackets, words without end."""
    begin, end = _span(draw, data)
    return data[:begin] + data[begin:end] * draw.choice((2, 3, 50, 2000)) + data[end:]


def spliced(draw: random.Random, data: bytes, corpus: Sequence[bytes], _words: Sequence[bytes]) -> bytes:
    """Go on as another one does."""
    other = draw.choice(corpus)
    return data[: draw.randrange(len(data) + 1)] + other[draw.randrange(len(other) + 1) :]


def in_archive(draw: random.Random, data: bytes, corpus: Sequence[bytes], words: Sequence[bytes]) -> bytes:
    """Change a file within an archive, whose checksums then are right; at times leave it out."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            files = [(name, packed.read(name)) for name in packed.namelist()]
    except Exception:  # it was changed beyond reading: go on with its bytes
        return flipped(draw, data, corpus, words)
    if not files:
        return data
    at = draw.randrange(len(files))
    name, content = files[at]
    kinds = (number, word) if content[:1] != b"\x93" else (flipped, flipped, number, cut_out, _header)
    files[at] = name, draw.choice(kinds)(draw, content, corpus, words)
    if draw.random() < 0.05:
        files.pop(at)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        for name, content in dict(files).items():
            packed.writestr(name, content)
    return out.getvalue()


def _header(draw: random.Random, data: bytes, _corpus: Sequence[bytes], _words: Sequence[bytes]) -> bytes:
    """Let an array say that it has another shape or kind."""
    shapes = (b"(99999999999,), }", b"(-1,), }", b"(3, 0), }", b"(1099511627776, 1099511627776), }")
    kinds = (b"'|O'", b"'<f4'", b"'<i8'", b"'<U9'", b"'<M8[ns]'", b"[('a', '|O')]", b"'<f16'")
    if draw.random() < 0.5:
        return re.sub(rb"\([\d, ]*\), \}", lambda _: draw.choice(shapes), data, count=1)
    return re.sub(rb"'[<|][\w]+'", lambda _: draw.choice(kinds), data, count=1)


TEXT: tuple[Mutation, ...] = (number, number, word, word, lines, flipped, cut_out, repeated, spliced)
BINARY: tuple[Mutation, ...] = (flipped, flipped, cut_out, repeated, spliced, word)
ARCHIVE: tuple[Mutation, ...] = (in_archive, in_archive, in_archive, flipped, cut_out)
