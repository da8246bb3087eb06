"""Technologies: what their files hold, offsets by number of passes, settings between heights, and bad ones."""

import math
import tomllib
from importlib import resources

import pytest

from edmsim.errors import InputError
from edmsim.evaluation.technology_search import Job, cut_pass
from edmsim.machine.options import available
from edmsim.machine.technology import (
    machine_of,
    read_technology,
    technology_for,
)

SHOP_MM = {
    1: (0.1727,), 2: (0.2057, 0.1397), 3: (0.2515, 0.1854, 0.1397), 4: (0.2692, 0.2032, 0.1575, 0.1397),
    5: (0.2769, 0.2108, 0.1651, 0.1473, 0.1321), 6: (0.2781, 0.2121, 0.1664, 0.1486, 0.1334, 0.1308),
    7: (0.2794, 0.2134, 0.1676, 0.1499, 0.1346, 0.1321, 0.1308),
}  # fmt: skip
"""Offsets of a shop by number of passes, brass 0.254 mm on 25.4 mm of steel."""
OURS = technology_for("tool-steel")


@pytest.mark.parametrize("passes", SHOP_MM)
def test_offsets_are_those_of_a_shop_within_15_percent(passes):
    found = OURS.table(25.4, passes)
    assert found.offsets_mm == pytest.approx(SHOP_MM[passes], rel=0.15)
    assert list(found.offsets_mm) == sorted(found.offsets_mm, reverse=True)
    assert found.notices == ()


def test_between_heights_it_interpolates_and_says_so():
    low, high = (OURS.table(mm, 4) for mm in (25.4, 76.2))
    for height_mm, said in ((44.0, "interpolated between those for 25.4 and 76.2 mm"), (20.0, "extrapolated from")):
        found, share = OURS.table(height_mm, 4), math.log(height_mm / 25.4) / math.log(3.0)
        assert said in found.notices[0]
        for name in ("t_on_us", "t_period_us", "feed_mm_min", "last_offset_um"):
            ends = [[getattr(one, name) for one in table.settings] for table in (low, high)]
            assert [getattr(one, name) for one in found.settings] == pytest.approx(
                [a * (b / a) ** share for a, b in zip(*ends, strict=True)]
            )
        ends = [[one.found.feed_mm_min for one in table.settings] for table in (low, high)]
        expected = [a * (b / a) ** share for a, b in zip(*ends, strict=True)]
        most = [one.feed_mm_min for one in found.settings]
        assert [one.found.feed_mm_min for one in found.settings] == pytest.approx([*map(min, expected, most)])


def test_a_single_height_gives_another_one_its_power_per_mm():
    found = technology_for("cemented-carbide")
    low, own, high = (found.table(mm, 4) for mm in (16.0, 25.4, 38.0))
    assert "extrapolated from those for 25.4 mm, by power per mm of height" in low.notices[0]
    periods = [[one.t_period_us for one in table.settings] for table in (low, own, high)]
    assert periods[0] == pytest.approx([us * 25.4 / 16.0 for us in periods[1]])  # lower: as much less power
    assert periods[2][1:] == pytest.approx([us * 25.4 / 38.0 for us in periods[1][1:]])
    assert periods[2][0] == periods[1][0]  # taller: a rough pass has no more power, and is slower
    assert high.settings[0].found.feed_mm_min == pytest.approx(own.settings[0].found.feed_mm_min * 25.4 / 38.0)
    assert low.settings[0].found == own.settings[0].found


@pytest.mark.slow
def test_a_lower_part_than_the_technology_knows_does_not_break_the_wire(monkeypatch):
    """With the power for 25.4 mm, carbide of 16 mm breaks it within seconds."""
    monkeypatch.setattr("edmsim.evaluation.technology_search.ROUGH_MM", 1.0)
    found = technology_for("cemented-carbide")
    (one,) = found.table(16.0, 1).settings
    tall = found.heights[0].passes[0]
    outcomes = [
        cut_pass(Job("cemented-carbide", height_mm=16.0, resolution="fast", seed=1), setting, 1, 0.5, None).outcome
        for setting in (one, tall)
    ]
    assert outcomes == ["finished", "wire-break"]


def test_every_setting_of_every_file_runs():
    for name in available("technologies"):
        found = read_technology(name)
        for at in found.heights:
            for one in at.passes:
                machine_of(one, found.machine, found.material, found.wire, at.height_mm).check()
                law, _, parameters = one.controller().partition(":")
                assert law == ("trim" if one.feed == "constant" else "counts")
                # a lead-in has no corners
                assert ("before_um=200," in parameters) == (law == "trim")
                assert "before_um" not in one.controller(scale=0.25)


def test_what_it_has_no_settings_for_is_refused_with_what_to_do():
    with pytest.raises(InputError, match=r"has 1 to 7 passes for 25\.4 mm, not 8: choose one of these"):
        OURS.table(25.4, 8)
    with pytest.raises(InputError, match="find some with edmsim tune technology tool-steel --height 5"):
        OURS.table(5.0, 2)
    with pytest.raises(InputError, match="there is no technology for copper, wire molybdenum-180; there are: ") as no:
        technology_for("copper", wire="molybdenum-180")
    assert str(no.value).endswith("edmsim tune technology copper --wire molybdenum-180")
    for names, named in (
        (("carbide", "production", "brass-250"), "unknown material 'carbide'"),
        (("copper", "production", "0.25"), "0.25"), (("copper", "fast", None), "unknown machine 'fast'"),
    ):
        with pytest.raises(InputError, match=named) as unknown:
            technology_for(*names)
        assert "technology" not in str(unknown.value)
    with pytest.raises(InputError, match="unknown technology 'steel'"):
        read_technology("steel")


@pytest.mark.parametrize(("before", "now", "named"), [
    ("step_um = 38.1", "step_um = -1", "step_um is below 0: the offset would grow"),
    ("height_mm = 76.2", "height_mm = 20", "heights must rise"),
    ("t_on_us = 1.1", "t_on_us = 0", "t_on_us"), ("t_on_us = 1.1", "on_us = 1.1", "on_us"),
    ("machine = ", "machine ", "not valid TOML"),
])  # fmt: skip
def test_a_damaged_file_is_refused_with_its_key(tmp_path, before, now, named):
    text = (resources.files("edmsim.models") / "technologies" / "tool-steel-brass-254.toml").read_text()
    assert before in text
    file = tmp_path / "own.toml"
    file.write_text(text.replace(before, now, 1))
    with pytest.raises(InputError) as refused:
        read_technology(file)
    assert named in str(refused.value)
    assert str(file) in str(refused.value)


def test_files_say_where_they_come_from():
    for name in available("technologies"):
        text = (resources.files("edmsim.models") / "technologies" / f"{name}.toml").read_text()
        assert "edmsim tune technology" in tomllib.loads(text)["source"]
