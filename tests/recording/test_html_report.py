"""``report.html``: one file that needs nothing else; and what a folder tells when it is read back."""

import base64
import dataclasses
import json
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest

from edmsim import InputError
from edmsim.job.result import remake
from edmsim.recording.html_report import page, pictures
from edmsim.recording.report import read_cut
from edmsim.recording.scene import read_scene, write_scene

NAMES = [
    "profile", "profile-error", "error-shares", "corner", "kerf-section", "face", "pulses", "short-open",
    "ignition-delay", "wire-spectrum",
]


class Page(HTMLParser):
    """What a page is made of: tags still open, addresses, pictures, text."""

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.addresses = []
        self.figures = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag not in ("meta", "img", "input"):
            self.open.append(tag)
        self.addresses += [attributes[key] or "" for key in ("src", "href") if key in attributes]
        if tag == "figure":
            self.figures.append(attributes["id"] or "")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style",):
            self.text += data + "\n"


@pytest.fixture(scope="module")
def written(small_cut):
    return Page((small_cut.folder / "report.html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_every_cut_writes_a_page_that_needs_no_other_file(written, small_cut):
    assert written.open == []
    assert written.figures == NAMES
    assert len(written.addresses) == len(NAMES)
    for address in written.addresses:
        kind, _, data = address.partition(";base64,")
        assert kind == "data:image/png"
        assert base64.b64decode(data, validate=True).startswith(b"\x89PNG")
    text = (small_cut.folder / "report.html").read_text(encoding="utf-8")
    assert not {"<script", "http://", "https://", "url(", "@import"} & set(text.split('"'))
    assert 'name="viewport"' in text
    assert text.count('<label class="enlarge"><input type="checkbox"') == len(NAMES)
    assert "prefers-color-scheme: dark" in text


@pytest.mark.slow
def test_the_page_holds_table_settings_and_notices(written, small_cut):
    report = small_cut.result.report
    for said in (
        "small.ngc", "finished", "tool-steel", "constants_sha256", f"{report['kerf_um']['mean']:.1f} µm",
        *report["notices"], f"{report['corners'][0]['error_um']:+.1f}".replace("-", "−"),
    ):  # fmt: skip
        assert said in written.text


def test_what_a_report_says_is_text_not_markup(cut):
    report = dataclasses.replace(
        cut.report, reason="the <b>wire</b> broke", outcome="wire-break", notices=['feed "F<2>" & more'],
        settings={"program": "a<script>.ngc", "max_time_s": None, "heights": []},
    )  # fmt: skip
    text = page(report, b"", [], ["not drawn: <i>"])
    shown = Page(text)
    assert "<script" not in text
    assert shown.open == []
    assert "wire-break: the <b>wire</b> broke" in shown.text
    assert 'feed "F<2>" & more' in shown.text
    assert "not drawn: <i>" in shown.text
    assert "max_time_s" not in shown.text


def test_a_scene_comes_back_from_its_file(cut, tmp_path):
    scene = dataclasses.replace(cut.scene, stop_mm=(1.0, 2.0))
    write_scene(scene, tmp_path / "part.npz")
    assert [file.name for file in tmp_path.iterdir()] == ["part.npz"]
    back = read_scene(tmp_path / "part.npz")
    assert back.corners == cut.scene.corners
    for name in ("stock_mm", "height_mm", "guides_z_mm", "wire_diameter_um", "stop_mm", "terraces"):
        assert getattr(back, name) == getattr(scene, name)
    np.testing.assert_array_equal(back.starts_mm, cut.scene.starts_mm)
    assert len(back.cut_edges_mm) == len(cut.scene.cut_edges_mm)
    for ours, theirs in zip(back.cut_edges_mm, cut.scene.cut_edges_mm, strict=True):
        for line, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(line, other)
    (edge,), (other) = back.maps, cut.scene.maps[0]
    assert edge.part_side == other.part_side
    for name in ("nominal_mm", "points_mm", "error_um"):
        np.testing.assert_array_equal(getattr(edge, name), getattr(other, name))


def test_a_scene_with_one_contour_split_and_one_not_comes_back(cut, tmp_path):
    """As of a program that cuts one contour with an offset and one with none."""
    (edge,) = cut.scene.maps
    split = dataclasses.replace(edge, shares_um=np.tile(edge.error_um / 5, (5, 1)))
    whole = dataclasses.replace(edge, shares_um=None)
    write_scene(dataclasses.replace(cut.scene, maps=(whole, split)), tmp_path / "part.npz")
    first, second = read_scene(tmp_path / "part.npz").maps
    assert first.shares_um is None
    np.testing.assert_array_equal(second.shares_um, split.shares_um)
    np.testing.assert_array_equal(first.error_um, whole.error_um)


@pytest.fixture
def folder(small_cut, tmp_path):
    for name in ("report.json", "windows.parquet", "part.npz"):
        shutil.copy(small_cut.folder / name, tmp_path / name)
    return tmp_path


@pytest.mark.slow
def test_a_page_made_again_is_the_one_the_cut_wrote(folder, small_cut):
    assert remake(folder, None, "pdf", print) == [folder / "report.html"]
    assert (folder / "report.html").read_bytes() == (small_cut.folder / "report.html").read_bytes()


@pytest.mark.slow
def test_figures_are_written_as_files(folder):
    files = remake(folder, folder / "figures", "svg", print)
    *drawn, captions = files
    assert [file.stem for file in drawn] == NAMES[1:]  # the whole cut is profile.png
    assert all("</svg>" in file.read_text(encoding="utf-8") for file in drawn)
    lines = captions.read_text(encoding="utf-8").splitlines()
    assert [line.partition(": ")[0] for line in lines] == [file.name for file in drawn]


def test_figures_with_nothing_to_show_are_left_out_with_the_reason(cut):
    left_out, scene = [], dataclasses.replace(cut.scene, maps=())
    partial = cut.windows.slice(0, 2)  # far from all corners
    shown = [picture.name for picture in pictures(cut.report, partial, scene, "no sample", left_out.append)]
    assert shown == ["pulses", "short-open"]
    assert left_out[0] == "ignition delays and the wire's spectrum are not drawn: no sample"
    assert left_out[-1] == "the figure face is left out (no face: no edge of the part was measured)"


@pytest.mark.slow
@pytest.mark.parametrize(("change", "said"), [
    (lambda f: (f / "report.json").unlink(), "report.json: no such file"),
    (lambda f: (f / "report.json").write_text("{"), "report.json: not the report of a cut"),
    (lambda f: (f / "report.json").write_text('{"settings": {}}'), "without outcome: cut again"),
    (lambda f: (f / "windows.parquet").write_bytes(b"PAR1"), "windows.parquet: not a Parquet file"),
    (lambda f: (f / "part.npz").unlink(), "part.npz: no such file"),
    (lambda f: (f / "part.npz").write_bytes((f / "part.npz").read_bytes()[:500]), "part.npz: damaged"),
])  # fmt: skip
def test_a_folder_that_cannot_be_used_is_refused_in_one_line(folder, change, said):
    change(folder)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(InputError, match=said.replace(".", r"\.")) as refused:
        remake(folder, None, "pdf", print)
    assert "\n" not in str(refused.value)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


@pytest.mark.slow
def test_another_layout_and_an_unknown_kind_are_refused(folder):
    with np.load(folder / "part.npz") as stored:
        arrays = dict(stored)
    document = json.loads(arrays["fields"].tobytes()) | {"version": 99}
    arrays["fields"] = np.frombuffer(json.dumps(document).encode(), np.uint8)
    np.savez(folder / "part.npz", **arrays)
    with pytest.raises(InputError, match="layout 99"):
        read_cut(folder)
    with pytest.raises(InputError, match="written as 'gif'; there are: pdf, svg, png"):
        remake(folder, folder / "figures", "gif", print)
    assert not (folder / "figures").exists()
