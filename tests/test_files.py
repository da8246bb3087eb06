"""Files of outputs: replaced whole; `tests/test_nothing_lost.py` has what happens when writing fails."""

from edmsim.files import replacing


def test_a_file_is_replaced_when_all_is_written(tmp_path):
    file = tmp_path / "report.json"
    file.write_text("old")
    with replacing(file) as partial:
        partial.write_text("new")
        assert file.read_text() == "old"
        assert partial.parent == file.parent
    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [("report.json", "new")]
