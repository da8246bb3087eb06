"""A user's own machine: the MJCF next to its TOML file is read, checked, and read again after a change."""

import os

import numpy as np
import pytest

import edmsim
from edmsim import models
from edmsim.errors import InputError
from edmsim.plant.constants import modal_model
from edmsim.plant.plant import Plant
from edmsim.plant.resolution import resolution

OURS = models.path("agiecut_dem15.xml").read_text(encoding="utf-8")
HEAVY = 'mass="25"', 'mass="50"'
NAME = ('model = "agiecut_dem15.xml"', 'model = "bench.xml"')


def write(folder, *changes):
    text = OURS
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "bench.xml"
    file.write_text(text, encoding="utf-8")
    return file


def modes(machine):
    return modal_model(machine, resolution("fast"))


def test_the_mjcf_next_to_the_file_is_the_machines(tmp_path, own_file):
    write(tmp_path, HEAVY)
    names = "agiecut-dem15", own_file("machines", "agiecut-dem15", NAME)
    ours, own = (modes(edmsim.Machine.load(name)) for name in names)
    np.testing.assert_allclose(own.wire_omega, ours.wire_omega)
    assert (own.table_omega[0] < ours.table_omega[0]).all()  # only the x carriage is heavier
    np.testing.assert_allclose(own.table_omega[1], ours.table_omega[1])


def test_a_file_of_ours_is_found_from_anywhere(own_file):
    own = edmsim.Machine.load(own_file("machines", "agiecut-dem15"))
    assert own.base.model == "agiecut_dem15.xml"


@pytest.mark.slow
def test_a_changed_mjcf_is_read_again(tmp_path, own_file):
    file = write(tmp_path)
    machine = edmsim.Machine.load(own_file("machines", "agiecut-dem15", NAME))
    before = modes(machine).table_omega[0]
    write(tmp_path, HEAVY)
    os.utime(file, ns=(0, 1))
    assert (modes(machine).table_omega[0] < before).all()


@pytest.mark.slow
def test_both_integrators_take_it_and_its_text_is_part_of_the_settings(tmp_path, own_file, small_punch):
    file = own_file("machines", "agiecut-dem15", NAME)
    digests, short = [], {"height_mm": 5, "resolution": "fast", "max_time_s": 0.1}
    for mechanics, changes in (("modal", ()), ("modal", (HEAVY,)), ("mujoco", (HEAVY,))):
        write(tmp_path, *changes)
        cut = edmsim.cut(small_punch, machine=file, mechanics=mechanics, **short)
        digests.append(cut.report["settings"]["constants_sha256"])
    assert digests[0] != digests[1] == digests[2]


@pytest.mark.parametrize(("change", "message"), [
    (("<mujoco ", "<muyoko "), "MuJoCo cannot use this MJCF"),
    (('joint name="y_rotor"', 'joint name="why_rotor"'), "this MJCF has no joint y_rotor"),
    (('<site name="upper_guide"', '<site name="top"'), "this MJCF has no site upper_guide"),
    (('<camera name="overview"', '<camera name="view"'), "this MJCF has no camera overview"),
    (('name="rotor_teeth" data="50"', 'name="rotor_teeth" data="0"'), "numeric rotor_teeth must be above 0"),
    (('<geom name="clamp_left"', '<geom name="clamp"'), "this MJCF has no geom clamp_left"),
])  # fmt: skip
def test_a_mjcf_that_cannot_be_used_is_one_line(tmp_path, own_file, change, message):
    file = write(tmp_path, change)
    machine = edmsim.Machine.load(own_file("machines", "agiecut-dem15", NAME))
    with pytest.raises(InputError, match=message) as error:
        Plant(machine, 0, resolution="fast")
    assert str(file) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_mjcf_that_is_nowhere_is_reported_when_the_machine_is_loaded(own_file):
    with pytest.raises(InputError, match=r"own\.toml: key 'model': there is no MJCF 'bench\.xml' in this file's"):
        edmsim.Machine.load(own_file("machines", "agiecut-dem15", NAME))
