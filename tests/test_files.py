"""Files of outputs: replaced whole, or not at all."""


import pytest

from edmsim.files import replacing


def test_a_file_is_replaced_when_all_is_written(tmp_path):
    file = tmp_path / "report.json"
    file.write_text("old")
    with replacing(file) as partial:
        partial.write_text("new")
        assert file.read_text() == "old"
        assert partial.parent == file.parent
    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [("report.json", "new")]


def test_a_file_stays_when_writing_fails_and_nothing_is_left_next_to_it(tmp_path):
    file = tmp_path / "report.json"
    file.write_text("old")

    def fail():
        with replacing(file) as partial:
            partial.write_text("half")
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        fail()
    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [("report.json", "old")]
