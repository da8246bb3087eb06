"""Output files are replaced completely; failures of writing are tested in `tests/test_nothing_lost.py`."""

from edmsim.files import replacing


def test_a_file_is_replaced_when_all_is_written(tmp_path):
    file = tmp_path / "report.json"
    file.write_text("old")
    with replacing(file) as partial:
        partial.write_text("new")
        assert file.read_text() == "old"
        assert partial.parent == file.parent
    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [("report.json", "new")]
