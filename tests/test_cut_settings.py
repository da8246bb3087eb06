"""The options of a cut: one list that the function, the command line, reports and tables of windows agree on."""

import inspect
from pathlib import Path

import pyarrow.parquet
import pytest
import shapely
from pydantic import ValidationError

import edmsim
from edmsim.controllers import make
from edmsim.job.options import METADATA_KEY, CutSettings
from edmsim.machine.options import Choices
from edmsim.recording.report import Offset


def test_the_function_shows_every_option_with_default_and_meaning():
    shown = inspect.signature(edmsim.cut).parameters
    said = inspect.getdoc(edmsim.cut) or ""
    for name, field in CutSettings.model_fields.items():
        assert shown[name].default == field.default
        assert field.description
        assert f"\n{name} : {shown[name].annotation}, " in said
    assert "\nwire_speed_m_s : float | None, optional\n    Speed of the running wire in m/s" in said


def test_texts_are_read_as_the_command_line_writes_them():
    settings = CutSettings(
        heights=["1:7.5"], constants=["gap.critical_um=5"], ignore="M77, U", guide_errors_mm="0.1:-0.05",
        offsets=Path("tool.off"),
    )  # fmt: skip
    assert (settings.heights, settings.overrides) == (((1.0, 7.5),), (("gap.critical_um", 5.0),))
    assert (settings.ignore, settings.guide_errors_mm, settings.offsets) == (("M77", "U"), (0.1, -0.05), "tool.off")


@pytest.mark.parametrize("option", ["planner", "mechanics", "resolution", "dialect", "taper_corners", "after_tab"])
def test_a_name_that_its_registry_does_not_have_is_refused_with_those_it_has(option):
    with pytest.raises(edmsim.InputError, match=f"unknown {option.replace('_', ' ')} 'none'; there are: [a-z]"):
        CutSettings(**{option: "none"})


def test_files_may_be_paths():
    for option in ("machine", "material", "wire", "generator", "technology", "compensation"):
        assert CutSettings(**{option: Path("own.toml")}) == CutSettings(**{option: "own.toml"})


@pytest.mark.parametrize(("option", "value", "message"), [
    ("out", b"out", "option out cannot be b'out': must not be bytes: decode them to text"),
    ("wire", bytearray(b"copper"), r"option wire cannot be bytearray\(b'copper'\): must not be bytes"),
    ("ignore", ["M77", b"U"], r"option ignore cannot be \['M77', b'U'\]: must not be bytes"),
    ("out", 3, "option out cannot be 3: give str | Path | None"),
    ("offset", [1], r"option offset cannot be \[1\]: give str | float"),
])
def test_values_of_another_type_are_refused_by_the_name_of_their_option(option, value, message):
    with pytest.raises(edmsim.InputError, match=message.replace("|", r"\|")):
        edmsim.cut("examples/slot.iso", **{option: value})


def test_settings_do_not_change():
    with pytest.raises(ValidationError, match="frozen"):
        CutSettings().height_mm = 10.0


def test_json_gives_the_same_settings_back():
    ring = shapely.Point(0, 0).buffer(3.1).difference(shapely.Point(0, 0).buffer(1 / 3))
    settings = CutSettings(
        height_mm=5, heights=[(1, 7.5)], height_areas=[([(0, 0), (1, 0), (1, 0.1)], 6), (ring, 8)], tension=9.5,
        controller="fixed:feed_um_s=11", offset=0.15, seed=3, max_time_s=1, open_voltage_V=90, peak_current_A=3,
        wire_speed_m_s=0.2, flushing_lower_Pa=0, flushing_upper_Pa=1e5, standoff_lower_mm=0.25, standoff_upper_mm=2,
    )  # fmt: skip
    again = CutSettings.of_json(settings.model_dump_json())
    assert again == settings
    assert again.height_areas[1][0].interiors[0].equals(ring.interiors[0])


def test_a_controller_passed_as_an_object_is_reported_as_the_command_line_has_it():
    settings = CutSettings(controller=make("fixed", feed_um_s=12.0))
    assert settings.model_dump()["controller"] == "fixed:feed_um_s=12.0,offset_um=0.0"


@pytest.mark.parametrize("text", ["", "[]", '{"colour": "red"}', '{"height_mm": 900}'])
def test_json_that_is_none_of_a_cut_is_refused_in_one_line(text):
    with pytest.raises(edmsim.InputError) as refused:
        CutSettings.of_json(text)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_the_windows_of_a_cut_tell_its_settings(small_cut):
    expected = CutSettings(height_mm=5.0, resolution="fast", seed=1)
    written = pyarrow.parquet.read_schema(small_cut.folder / "windows.parquet")
    for schema in (small_cut.result.windows.schema, written):
        assert CutSettings.of_json(schema.metadata[METADATA_KEY]) == expected


@pytest.mark.slow
def test_options_that_an_earlier_report_does_not_have_are_at_their_default(small_cut):
    report = small_cut.result.report
    earlier = {k: v for k, v in report["settings"].items() if k not in Choices.model_fields}
    assert CutSettings.of_report({**report, "settings": earlier}) == CutSettings.of_report(report)


@pytest.mark.slow
def test_a_report_of_contours_with_different_offsets_leaves_them_to_the_registers(small_cut):
    report = small_cut.result.report
    several = {**report, "settings": {**report["settings"], "offset_um": None}}
    assert CutSettings.of_report(several).offset == "auto"
    assert str(Offset(None, 2.0, None)) == "different ones by contour, +2.0 µm in the mean (metal left)"


@pytest.mark.slow
def test_a_report_gives_the_set_up_of_its_cut(small_cut, tmp_path):
    settings = CutSettings.of_report(small_cut.result.report)
    assert settings.load_machine() == small_cut.result.machine
    assert (settings.seed, settings.resolution, settings.controller) == (1, "fast", "counts")
