"""A user's table of settings for the conditions that a program calls."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.job.options import CutSettings
from edmsim.machine.options import Choices
from edmsim.program import load_program
from edmsim.program.tables import SETTINGS, key_of, read_conditions

EXAMPLES = Path(__file__).parents[2] / "examples" / "dialects"
PUNCH = EXAMPLES / "punch-sodick.nc"


def test_the_settings_of_conditions_are_found_under_the_names_of_the_program():
    program = load_program(PUNCH, conditions=EXAMPLES / "conditions.toml")
    assert {outline.condition for outline in program.outlines} <= program.settings.keys()
    assert program.settings["C001"]["t_on_us"] == 1.2
    assert program.settings["C002"]["feed_um_s"] == 75.0
    assert not any("no settings" in notice for notice in program.notices)


def test_without_a_table_a_notice_says_so():
    program = load_program(PUNCH)
    assert program.settings == {}
    assert any("no settings for the conditions C000, C001" in notice for notice in program.notices)


def test_leading_zeros_do_not_matter(tmp_path):
    table = "".join(f"[{name}]\nt_on_us = {number}\n" for number, name in enumerate(("c1", "C0", "C02", "C3"), 1))
    (tmp_path / "table.toml").write_text(table)
    settings = load_program(PUNCH, conditions=tmp_path / "table.toml").settings
    assert [settings[name]["t_on_us"] for name in ("C000", "C001", "C002", "C003")] == [2, 1, 3, 4]


def test_every_setting_is_one_of_a_cut_or_of_a_feed():
    options = {"tension_N" if name == "tension" else name for name in CutSettings.model_fields}
    assert set(SETTINGS) - options == {"open_target_share", "feed_um_s"}
    numbers = {name for name in Choices.model_fields if name not in ("pulse_shape", "ignition_wait_us")}
    assert {name for name in numbers if "standoff" not in name} <= set(SETTINGS)


BAD = [
    ("", "the table is empty"), ("t_on_us = 1\n", "invalid condition name 't_on_us'"), ("[C001]\n", "C001 is empty"),
    ("[C001]\nt_on_us = 1\n[C1]\nt_on_us = 1\n", "C1 occurs twice"), ("[C001]\nt_on = 1\n", "unknown setting 't_on'"),
    ("[C001]\nt_on_us = 0\n", "give above 0 to"), ("[C001]\nt_on_us = 'long'\n", "'long'"),
    ("[C001]\nt_on_us = true\n", "True"), ("[C001]\nflushing_lower_Pa = -1\n", "give 0 to"),
    ("[C001]\nopen_target_share = 40\n", "give 0 to 1"),
    ("[C001]\nopen_target_share = 0.4\nfeed_um_s = 50\n", "a set point and a constant feed"),
    ("[C001\n", "not a table of conditions"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "what"), BAD)
def test_tables_that_make_no_sense(tmp_path, text, what):
    (tmp_path / "table.toml").write_text(text)
    with pytest.raises(InputError) as refused:
        load_program(PUNCH, conditions=tmp_path / "table.toml")
    assert what in refused.value.reason
    assert refused.value.file == str(tmp_path / "table.toml")


def test_a_condition_that_is_missing_is_named_with_its_line(tmp_path):
    (tmp_path / "table.toml").write_text("[C000]\nt_on_us = 1\n[C001]\nt_on_us = 1\n")
    with pytest.raises(InputError, match=r"C002 is not in the table of conditions: there are C0, C1") as refused:
        load_program(PUNCH, conditions=tmp_path / "table.toml")
    assert refused.value.line == 17
    with pytest.raises(InputError, match="no such file"):
        read_conditions(tmp_path / "none.toml")


@pytest.mark.slow
@given(st.from_regex(r"[CES][0-9]{1,4}", fullmatch=True))
def test_a_name_is_found_however_many_zeros_it_has(name):
    assert key_of(name) == f"{name[0]}{int(name[1:])}"
    assert key_of(key_of(name)) == key_of(name)
