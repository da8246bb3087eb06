"""`edmsim check`, and what the command line says of options: one line for bad usage, names for what there is."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, get_type_hints

import numpy as np
import pyarrow.parquet as pq
import pytest

from edmsim import controllers
from edmsim.cli import app as cli
from edmsim.cli import console, evaluate, learn
from edmsim.cli import cut as cutting
from edmsim.cosim.simulation import Simulation
from edmsim.errors import InputError
from edmsim.job.check import check, greatest_feed_um_s
from edmsim.job.cut import make_controller
from edmsim.job.settings import CutSettings
from edmsim.machine.files import available
from edmsim.machine.machine import Machine

EXAMPLES = Path(__file__).parents[1] / "examples"


class Outcome(NamedTuple):
    status: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def edmsim(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Run the command line in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["edmsim", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        return Outcome(left.value.code if isinstance(left.value.code, int) else 0, *capsys.readouterr())

    return run


def test_a_program_is_drawn_beside_its_figures(edmsim: Run, tmp_path: Path) -> None:
    told = edmsim("check", EXAMPLES / "gear.dxf")
    assert (told.status, told.err) == (0, "")
    assert re.search(r"^contour 2 +closed, 7\.000 x 7\.000 mm", told.out, re.MULTILINE)
    assert "24 sharp inner corners" in told.out
    assert "at least 24 min" in told.out
    assert [str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*.*")] == ["out/gear/path.png"]


def test_unknown_words_are_listed_with_everything_else(edmsim: Run, tmp_path: Path) -> None:
    program = tmp_path / "words.ngc"
    program.write_text("O12\nG92 X0 Y0\nG41 D1 G1 X5\nM77\nY5 V3\nX9.5\nY0\nX5 V3\nM2\n")
    told = edmsim("check", program, "--out", tmp_path / "path.svg")
    assert told.status == 2
    assert told.err.splitlines() == [
        f"edmsim: {program}:4: unknown word M77",
        f"edmsim: {program}:5: unknown word V3, 2 times",
        "edmsim: what follows leaves them out, as --ignore M77,V3",
    ]
    assert "offset register D1" in told.out
    assert (tmp_path / "path.svg").read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("check", EXAMPLES / "gear.dxf", "--out", "path.bmp"), "path.bmp: the picture must end in .png, .svg"),
        (("check", "no-such.ngc"), "no-such.ngc: no such file"),
        (("cut", "a.ngc", "--traces", "a.csv"), "a.csv: the file for traces must end in .parquet"),
        (("cut", "a.ngc", "--colour", "red"), "no such option: --colour"),
        (("cut",), "missing argument 'program'; see edmsim cut --help"),
        (("cut", "a.ngc", "--height", "tall"), "invalid value for '--height'"),
        (("saw",), "no such command 'saw'; see edmsim --help"),
    ],
)
def test_bad_usage_is_one_line(edmsim: Run, tmp_path: Path, arguments: tuple[object, ...], named: str) -> None:
    told = edmsim(*arguments)
    assert (told.status, told.out) == (2, "")
    assert told.err.startswith("edmsim: ")
    assert told.err.count("\n") == 1
    assert named in told.err
    assert list(tmp_path.iterdir()) == []


def test_a_cut_goes_to_a_folder_of_its_program_and_its_traces_to_a_file(
    edmsim: Run, tmp_path: Path, small_punch: Path
) -> None:
    told = edmsim(
        "cut", small_punch, "--height", 5, "--resolution", "fast", "--max-time", 0.3,
        "--traces", "kept/traces.parquet",
    )  # fmt: skip
    assert told.status == 3
    assert f"Written to {Path('out') / 'small'}" in told.out
    assert (tmp_path / "out" / "small" / "report.json").is_file()
    samples = pq.read_table(tmp_path / "kept" / "traces.parquet")
    assert samples.num_rows > 0
    assert (np.diff(samples["window_t_s"].to_numpy()) >= 0).all()


def test_help_names_what_there_is() -> None:
    for option, kind in ((console.Machine, "machines"), (console.Material, "materials"), (console.Wire, "wires"),
                         (console.Generator, "generators")):  # fmt: skip
        told = set(re.findall(r"[\w-]+", option.__metadata__[0].help))
        assert set(available(kind)) <= told, kind
    assert f"Feed controller: {', '.join(controllers.choices(cutting=True))};" in help_of(cutting.cut, "controller")
    cuts = controllers.choices(cutting=True)
    others = ", ".join(("edmsim cut", *(name for name in controllers.choices() if name not in cuts)))
    for command in (evaluate.evaluate, learn.dataset):
        assert f"Feed controllers: those of {others}" in help_of(command, "controllers")


def help_of(command: Callable[..., None], name: str) -> str:
    """What an option of a command says of itself."""
    return str(get_type_hints(command, include_extras=True)[name].__metadata__[0].help)


def test_what_is_listed_of_controllers_can_be_cut_with_and_what_is_not_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text("from edmsim.controllers.feed.fixed import FixedController as Own\n", encoding="utf-8")
    filled = {"policy:FILE": "policy:GapFeed-ppo", "own.py:Own": f"{own}:Own"}
    cuts, all_of_them = controllers.choices(cutting=True), controllers.choices()
    for text in cuts:
        assert make_controller(filled.get(text, text))
    for text in set(all_of_them) - set(cuts):
        with pytest.raises(InputError, match="not cut with"):
            make_controller(text)
    listed = re.escape(", ".join(cuts))
    with pytest.raises(InputError, match=f"'genius'; choose one of {listed}$"):
        make_controller("genius")
    with pytest.raises(InputError, match=f"'genius'; choose one of {re.escape(', '.join(all_of_them))}$"):
        controllers.from_text("genius")


def test_the_least_time_is_that_of_the_path_at_the_greatest_feed(small_punch: Path) -> None:
    found = check(small_punch, CutSettings(height_mm=5.0))
    simulation = Simulation(found.machine, found.path, controllers.make("counts"), resolution="fast")
    assert found.limited_by == "machine"
    assert found.feed_um_s == simulation.max_feed_um_s
    assert found.least_s == pytest.approx(simulation.total_um / simulation.max_feed_um_s)


def test_a_tall_workpiece_is_limited_by_the_generator() -> None:
    machine = Machine.load(height_mm=400.0)
    feed_um_s, limited_by = greatest_feed_um_s(machine, 400.0)
    assert limited_by == "generator"
    # what all pulses together remove in a second fills the kerf of that second
    removed_mm3 = 6.61 * 0.3 * machine.material.burning_voltage_V.value * machine.material.removal_mm3_J.value
    assert feed_um_s * 1e-3 * 400.0 * 2 * machine.auto_offset_mm == pytest.approx(removed_mm3, rel=1e-3)
    assert greatest_feed_um_s(machine, 200.0)[0] == pytest.approx(2 * feed_um_s)
