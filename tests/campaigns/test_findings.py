"""What the campaign found, each as small as it could be made; every one of them failed before it was mended."""

import gc
import io
import json
import shutil
import time
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from edmsim import controllers, models
from edmsim.controllers.axis.elcam.file import read_tables
from edmsim.controllers.axis.elcam.table import CamTable
from edmsim.controllers.qcl import Control, read_configuration, read_program
from edmsim.errors import LONGEST_REASON, InputError
from edmsim.files import read_arrays
from edmsim.plant.mechanics.model import read_mjcf
from edmsim.program.path import load_program, plan_path
from edmsim.recording.report import read_cut
from edmsim.recording.windows import read_windows
from edmsim.sweep.run import Store, read, read_part
from edmsim.sweep.specification import read_specification, values_of

CONFIGURATION = read_configuration("GLOBAL\nspeed L\n")


def one_line(error):
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("expression", [
    "(" * 21 + "speed" + ")" * 21, "speed" + " + speed" * 5000, "(" * 5000, "9" * 5000, "speed * \u00b2",
])  # fmt: skip
def test_expressions_without_end_are_refused(expression):
    """They ended in a RecursionError, in minutes of multiplying, or in Python's limit of digits."""
    with pytest.raises(InputError) as caught:
        read_program(f"speed = {expression}\nEND\n", CONFIGURATION)
    one_line(caught)


@pytest.mark.slow
@pytest.mark.parametrize("moves", [
    "Y.2\nX.2\n" * 2000, "Y.1\nG41 D1 G1 X.05\n" * 2000, "Y.2\nX.2\nY-.2\nX.2\n" * 900,
])  # fmt: skip
def test_a_job_of_many_tables_is_refused_as_drawn(moves, tmp_path):
    """The path beside it was looked for first, and its lead-ins: 5 s for 46 kB."""
    (tmp_path / "own.ngc").write_text(f"G20 G91\nG0 X.1 Y.1\nG41 D1 G1 X.05\n{moves}G40\nM2\n")
    for _ in range(2):  # the first run imports what is needed
        began = time.process_time()
        with pytest.raises(InputError, match=r"what is drawn spans [\d.]+ x [\d.]+ mm: the table has 65 x 65 mm"):
            plan_path(tmp_path / "own.ngc", "auto", auto_offset_mm=0.15, table_um=65_000)
    assert time.process_time() - began < 1.0


def test_a_line_of_thousands_of_words_is_read_at_once(tmp_path):
    """Each word looked through all before it for the program's end: 1.6 s for 8000 of them."""
    (tmp_path / "own.ngc").write_text(f"G21 G90\nG0 X0 Y0\n{'G4' * 25_000}\n")
    began = time.process_time()
    with pytest.raises(InputError, match="G4 needs its time"):
        load_program(tmp_path / "own.ngc")
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize("filled", ["N7" + " " * 100_000 + "M2", "X1" + "*" * 20_000 + "1"])
def test_a_line_of_thousands_of_blanks_or_marks_is_read_at_once(filled, tmp_path):
    """A pattern for marks of comments went over the blanks from every one of them: 4,000 took three minutes."""
    file = tmp_path / "part.ngc"
    file.write_text(f"G21 G90\nG1 X1 Y0\n{filled}\n")
    began = time.process_time()
    with suppress(InputError):
        load_program(file)
    assert time.process_time() - began < 5.0


def test_expressions_of_a_page_are_computed():
    """The limits leave room: 20 brackets within each other, a hundred terms."""
    deep = "(" * 20 + "3" + ")" * 20
    control = Control(CONFIGURATION, read_program(f"speed = {deep}" + " + 1" * 70 + "\nEND\n", CONFIGURATION), {})
    control.run_pass()
    assert control.variables["speed"] == 73


@pytest.mark.parametrize("line", ["CONST\nn " + "9" * 5000, "BUS\n\u00b2 CARD 01", "CONST\nn \u0663"])
def test_numbers_of_a_configuration_are_digits(line):
    with pytest.raises(InputError, match="QCL:2"):
        read_configuration(line)


def test_a_table_of_denormal_width_holds_its_ends():
    """The number of its repetitions overflowed."""
    table = CamTable()
    table.points = np.array([[0.0, 1.0], [5e-324, 3.0]])
    table.size_master = table.size_follow = 2
    assert 1.0 <= table.follow(1e9, 0.0) <= 3.0


@pytest.mark.parametrize("changed", [
    "points = [[0, 0], [1, DIGITS]]", "points = [[0, 0], [1, 1]]\nreversal_um = DIGITS",
])  # fmt: skip
def test_compensation_of_hundreds_of_digits_is_refused(changed, tmp_path):
    file = tmp_path / "own.toml"
    file.write_text(f'[[table]]\naxis = "x"\nmaster = "x"\n{changed}\n'.replace("DIGITS", "9" * 400))
    with pytest.raises(InputError, match="table 1") as caught:
        read_tables(file)
    one_line(caught)


@pytest.mark.parametrize(("text", "named"), [
    ('environment = "edmsim/GapFeed-v2"\nseeds = 1000000000000', "seeds are too many"),
    (f'program = "{"a" * 5000}"', "no such program"),
    ('program = "a\\u0000b"', "no such program"),
    (f"seeds = {'9' * 5000}", "not valid TOML"),
    ("grid = " + "[" * 50_000, "not valid TOML"),
    ('environment = "a/b-v1"\n[grid' + ".a" * 5000 + "]\nb = [1]", "too deep|1000 parts"),
    ('environment = "a/b-v1"\n[sobol]\nsamples = 4\n[sobol.ranges]\na = [1, ' + "9" * 400 + "]", "Sobol sample is"),
    ('environment = "a/b-v1"\n[sobol]\nsamples = 1152921504606846976\n[sobol.ranges]\na = [1, 2]', "samples"),
])  # fmt: skip
def test_specifications_beyond_all_reason_are_refused(text, named, tmp_path):
    file = tmp_path / "own.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=named):
        read_specification(file)


@pytest.mark.parametrize("line", ["{", "[]", '{"id": 1, "task": "a"}', '{"task": "a"}', "\xff", "[" * 50_000])
def test_a_damaged_journal_is_refused_by_its_line(line, tmp_path):
    good = json.dumps({"id": "a", "task": "a.ngc", "error": None})
    (tmp_path / "journal.jsonl").write_bytes(f"{good}\n".encode() + line.encode("latin-1") + b"\n")
    for look in (read, Store):
        with pytest.raises(InputError, match=r"journal\.jsonl:2: the journal is damaged") as caught:
            look(tmp_path)
        one_line(caught)
    (tmp_path / "journal.jsonl").write_bytes(f"{good}\n".encode() + line.encode("latin-1"))  # cut off: none
    assert read(tmp_path).num_rows == 1


def test_rows_of_a_journal_that_no_table_holds_are_refused(tmp_path):
    (tmp_path / "journal.jsonl").write_text('{"id": "a", "task": "a", "seed": 1e99}\n')
    with pytest.raises(InputError, match="damaged, or not of one sweep"):
        read(tmp_path)


def test_a_damaged_part_of_a_dataset_is_refused(tmp_path):
    folder = tmp_path / "results" / "task=a"
    folder.mkdir(parents=True)
    (folder / "part-000000.parquet").write_bytes(b"PAR1 nothing")
    for look in (read, Store):
        with pytest.raises(InputError, match="no part of a sweep's results") as caught:
            look(tmp_path)
        one_line(caught)
    shutil.copy(Path(__file__).parent / "corpus/cut/windows.parquet", folder / "part-000000.parquet")
    with pytest.raises(InputError, match="it has no column"):
        read_part(folder / "part-000000.parquet")


def packed(name, header, body):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr(name, b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + body)
    return out.getvalue()


@pytest.mark.parametrize(("header", "named"), [
    ("{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }", "another size than it says"),
    ("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }", "is not an array of numbers"),
    ("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", "is not an array of numbers"),
    ("nothing", "header|Header|EOF|malformed"), ("{" * 500, "."), ("-" * 9000 + "1", "no header of an array"),
])  # fmt: skip
def test_arrays_that_are_none_take_no_memory(header, named):
    """A header that spoke of 800 GB was believed: MemoryError."""
    with pytest.raises(ValueError, match=named) as caught:
        read_arrays(packed("a.npy", header.encode(), bytes(8)))
    assert len(str(caught.value).splitlines()) == 1


def test_an_archive_with_something_else_is_none_of_arrays():
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("weight_0", b"text")
    for data in (out.getvalue(), b"PK\x03\x04", b""):
        with pytest.raises(ValueError, match=r"."):
            read_arrays(data)
    rows = np.zeros(2, [("x", "<i4"), ("y", "<f4", 3)])
    arrays = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.zeros((0, 2)), "c": rows}
    out = io.BytesIO()
    np.savez(out, **arrays)
    np.testing.assert_equal(read_arrays(out.getvalue()), arrays)


def test_too_little_memory_is_no_damage(monkeypatch):
    """Whatever happened while arrays were read, their file was called damaged."""
    out = io.BytesIO()
    np.savez(out, a=np.zeros(3))

    def load(*_, **__):
        raise MemoryError

    monkeypatch.setattr(np, "load", load)
    with pytest.raises(MemoryError):
        read_arrays(out.getvalue())


@pytest.mark.parametrize("kind", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_arrays_compressed_as_numpy_does_not_are_refused(kind):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as archive:
        archive.writestr("a.npy", b"nothing")
    with pytest.raises(ValueError, match="is compressed in another way than by numpy"):
        read_arrays(out.getvalue())


def test_a_message_is_one_line_that_ends():
    """What was given stood in it as it came: other lines, bells, thousands of characters."""
    message = str(InputError("there is no 'a\nb\x07\u2028c': choose one", "own.toml", 3))
    assert message == "own.toml:3: there is no 'a b  c': choose one"
    long = InputError(f"'{'x' * 9000}' is unknown; there are: counts, fixed")
    assert len(str(long)) == LONGEST_REASON
    assert str(long).startswith("'xxx")
    assert str(long).endswith("x' is unknown; there are: counts, fixed")
    assert InputError(long.reason).reason == long.reason


def test_names_of_a_mjcf_that_are_no_text_are_refused(tmp_path):
    text = models.path("agiecut_dem15.xml").read_bytes()
    text = text.replace(b'<body name="x_carriage"', b'<body name="x_carriag\xff"')
    assert b"\xff" in text
    (tmp_path / "own.xml").write_bytes(text)
    with pytest.raises(InputError) as caught:
        read_mjcf(str(tmp_path / "own.xml"))
    one_line(caught)


def test_columns_whose_names_are_no_text_are_refused(tmp_path):
    data = (Path(__file__).parent / "corpus/cut/windows.parquet").read_bytes()
    assert data.count(b"mean_delay_us") > 1
    (tmp_path / "windows.parquet").write_bytes(data.replace(b"mean_delay_us", b"mean_dela\xff_us"))
    for look in (read_windows, read_part):
        with pytest.raises(InputError) as caught:
            look(tmp_path / "windows.parquet")
        one_line(caught)


def test_a_report_of_thousands_of_brackets_is_refused(tmp_path):
    for file in (Path(__file__).parent / "corpus/cut").iterdir():
        shutil.copy(file, tmp_path)
    (tmp_path / "report.json").write_text('{"settings": ' + "[" * 50_000, encoding="utf-8")
    gc.collect()  # objects of earlier tests, whose finalizers would fail at the depth that this one reaches
    with pytest.raises(InputError, match="not the report of a cut") as caught:
        read_cut(tmp_path)
    one_line(caught)


def test_a_users_file_with_a_zero_byte_in_its_name_is_refused():
    with pytest.raises(InputError, match="cannot be read") as caught:
        controllers.from_text("a\0b.py")
    one_line(caught)


def test_a_file_name_of_thousands_of_characters_is_shortened():
    assert len(str(InputError("there is no such program", "a" * 9000))) < 400


@pytest.mark.parametrize("text", ["9" * 3000 + ":" + "9" * 3000, "1:" + "9" * 3000 + ":x"])
def test_a_range_of_thousands_of_digits_does_not_hang(text):
    """The pattern of a number tried every way to part its digits: minutes."""
    began = time.process_time()
    assert values_of(text, "height") == [text]
    assert time.process_time() - began < 1.0
