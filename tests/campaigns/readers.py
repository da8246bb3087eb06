"""Every reader of edmsim: what reads an input, good inputs to begin from, and words of its language."""

import hashlib
import io
import math
import re
import struct
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from edmsim import Machine, controllers, models
from edmsim.calibration.log import COLUMNS, STRETCH_WINDOWS, read_log, stretches
from edmsim.closed_loop.simulation import Simulation
from edmsim.consoles.positioner import press_of
from edmsim.controllers import axis, make
from edmsim.controllers.axis.elcam.file import load_tables, read_tables
from edmsim.job.cut import CHECKPOINT, load_checkpoint, save_checkpoint
from edmsim.learning import policy_file
from edmsim.plant.mechanics.model import _read_mjcf
from edmsim.program.heights import parse_height
from edmsim.program.path import plan_path
from edmsim.recording.report import read_cut
from edmsim.sweep.run import read
from edmsim.sweep.specification import read_specification, values_of

from . import devices

ROOT = Path(__file__).parents[2]
CORPUS = Path(__file__).parent / "corpus"
Read = Callable[[bytes, Path], object]


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes
    ----------
    name : str
    read : callable
        Takes an input and a folder for it.
    good : callable
        Returns good inputs.
    words : tuple of bytes
        Of its language.
    share : float
        Of all inputs, relative to the others': what is fast reads more.
    """

    name: str
    read: Read
    good: Callable[[], Sequence[bytes]]
    words: tuple[bytes, ...] = ()
    share: float = 1.0

    @cached_property
    def corpus(self) -> tuple[bytes, ...]:
        """Good inputs."""
        return tuple(self.good())


def _file(name: str, read: Callable[[Path], object]) -> Read:
    """Let a reader of files read an input from a file of this name."""

    def from_file(data: bytes, folder: Path) -> object:
        file = folder / name
        file.write_bytes(data)
        return read(file)

    return from_file


def _files(*names: str) -> Callable[[], list[bytes]]:
    return lambda: [(ROOT / name).read_bytes() for name in names]


def _stored(folder: str, *others: str) -> Callable[[], list[bytes]]:
    return lambda: [file.read_bytes() for file in sorted((CORPUS / folder).iterdir())] + _files(*others)()


def _models(*patterns: str) -> Callable[[], list[bytes]]:
    top = Path(models.__file__).parent
    return lambda: [file.read_bytes() for pattern in patterns for file in sorted(top.glob(pattern))]


def _text(*texts: str) -> Callable[[], list[bytes]]:
    return lambda: [text.encode() for text in texts]


def _words(text: str) -> tuple[bytes, ...]:
    return (*text.encode().split(), b"\r", b"\n", b" ")


def _gcode(file: Path) -> object:
    return plan_path(file, "auto", auto_offset_mm=0.15, table_um=65_000)


def _part(kind: str) -> Read:
    """Load a machine, or one with this part, from an input."""
    return _file("own.toml", lambda file: Machine.load(**{kind: str(file)}))


def _mjcf(data: bytes, folder: Path) -> object:
    file = folder / "own.xml"
    file.write_bytes(data)
    return _read_mjcf.__wrapped__(str(file), 0)  # not kept: every input is another


def _log(name: str) -> Read:
    return _file(name, lambda file: stretches(read_log(file), 0.0))


def _good_log() -> list[bytes]:
    out = io.BytesIO()
    pa.csv.write_csv(_log_table(), out)
    return [out.getvalue()]


def _good_parquet() -> list[bytes]:
    files = []
    for table in (_log_table(), _log_table().cast(pa.schema([(n, pa.float32()) for n in _log_table().column_names]))):
        out = io.BytesIO()
        pq.write_table(table, out)
        files.append(out.getvalue())
    return files


def _log_table() -> Any:
    row = {"feed_um_s": 20.0, "short": 10.0, "open": 100.0, "mean_voltage_V": 60.0, "mean_current_A": 3.0,
           "mean_delay_us": 14.0, "t_on_us": 30.0, "t_period_us": 100.0}  # fmt: skip
    return pa.table({name: np.full(STRETCH_WINDOWS, row[name]) for name in COLUMNS})


def _policy(data: bytes, folder: Path) -> object:
    """Read a policy whose card, or whose arrays, are the input; the card then has the arrays' digest."""
    card, packed = _good_policy()
    if data[:2] == b"PK":
        packed = data
        card = re.sub(rb'(arrays_sha256": ?")\w+', rb"\g<1>" + hashlib.sha256(data).hexdigest().encode(), card)
    else:
        card = data
    (folder / "own.npz").write_bytes(packed)
    (folder / "own.json").write_bytes(card)
    policy = policy_file.load(str(folder / "own.json"))
    return policy.action(np.zeros(len(policy.card.observation)))


def _good_policy() -> list[bytes]:
    return _models("policies/GapFeed-ppo.json", "policies/GapFeed-ppo.npz")()


def _cut_folder(name: str) -> Read:
    def read(data: bytes, folder: Path) -> object:
        for file in (CORPUS / "cut").iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        (folder / name).write_bytes(data)
        return read_cut(folder)

    return read


def _checkpoint() -> tuple[Read, Callable[[], list[bytes]]]:
    made: list[Any] = []

    def fresh() -> Any:
        if not made:
            path = plan_path(CORPUS / "gcode" / "line.ngc", "none", auto_offset_mm=0.0, table_um=65_000)
            machine = Machine.load(height_mm=5.0)
            made.append(Simulation(machine, path, make("counts"), seed=1, resolution="fast", max_time_s=10.0))
        return made[0]

    def good() -> list[bytes]:
        with tempfile.TemporaryDirectory() as name:
            save_checkpoint(fresh(), Path(name) / CHECKPOINT, {}, 0.0)
            return [(Path(name) / CHECKPOINT).read_bytes()]

    def read(data: bytes, folder: Path) -> object:
        (folder / CHECKPOINT).write_bytes(data)
        return load_checkpoint(fresh(), folder / CHECKPOINT, {})

    return read, good


def _specification(file: Path) -> object:
    return read_specification(file).runs


def _good_specifications() -> list[bytes]:
    program = str(CORPUS / "gcode" / "line.ngc").encode()
    return [file.read_bytes().replace(b"PROGRAM", program) for file in sorted((CORPUS / "sweep").iterdir())]


def _results(data: bytes, folder: Path) -> object:
    (folder / "journal.jsonl").write_bytes(data)
    return read(folder)


def _options(data: bytes, _folder: Path) -> object:
    """Read a text as each option that has a language of its own; the first byte says which."""
    readers: tuple[Callable[[str], object], ...] = (
        controllers.from_text, axis.from_text, parse_height, press_of, lambda text: values_of(text, "height"),
    )  # fmt: skip
    text = data[1:].decode("utf-8", "replace")
    return readers[(data[0] - ord("0")) % len(readers)](text) if data else None


def _compensation(file: Path) -> object:
    return load_tables(read_tables(file), file)


_read_checkpoint, _good_checkpoint = _checkpoint()
_G = _words("G0 G1 G2 G3 G4 G20 G21 G40 G41 G42 G90 G91 G92 G92.1 M2 M30 X Y I J R D P F N % ( ) ; / # [ ] O100 M98")
_TOML = _words("[a] [[a]] = { } [ ] value range like true false 1979-05-27T07:32:00 ''' \"\"\" inf nan \\u0000")
_DXF = tuple(f"{a}\n{b}\n".encode() for a, b in (
    (0, "LINE"), (0, "SPLINE"), (0, "ARC"), (0, "CIRCLE"), (0, "ELLIPSE"), (0, "LWPOLYLINE"), (0, "INSERT"),
    (0, "HATCH"), (0, "ENDSEC"), (8, "0"), (10, "1e20"), (40, "-1"), (41, "0"), (62, "-7"), (70, "65535"), (71, "3"),
    (72, "8"), (73, "4"), (210, "0"), (230, "-1"), (2, "A"), (44, "1e-9"), (70, "100000"),
))  # fmt: skip
_XML = _words("<body/> <joint/> <geom/> <include file='a.xml'/> <mesh file='/etc/passwd'/> <replicate count='9'> "
              "mass='0' mass='-1' name='x' type='free' <option timestep='0'/> <!-- &amp; </body>")
_ALL: tuple[Reader, ...] = (
    Reader("gcode", _file("own.ngc", _gcode), _stored("gcode", "examples/punch.ngc", "examples/slot.iso"), _G, 80),
    Reader("dxf", _file("own.dxf", _gcode), _stored("dxf"), _DXF, 1.5),
    Reader("machine", _part("name"), _models("machines/*.toml"), _TOML, 3),
    Reader("material", _part("material"), _models("materials/*.toml"), _TOML, 5),
    Reader("wire", _part("wire"), _models("wires/*.toml"), _TOML, 8),
    Reader("generator", _part("generator"), _models("generators/*.toml"), _TOML, 8),
    Reader("mjcf", _mjcf, _models("*.xml"), _XML, 0.3),
    Reader("log-csv", _log("own.csv"), _good_log, _words(", \" 1e400 NaN null true \xff"), 10),
    Reader("log-parquet", _log("own.parquet"), _good_parquet, (), 10),
    Reader("policy", _policy, _good_policy, _words("NaN Infinity null [] {} \"tanh\" \"relu\" 1e400 [0] -1"), 2),
    Reader("cut-report", _cut_folder("report.json"), lambda: [(CORPUS / "cut/report.json").read_bytes()], (), 4),
    Reader("cut-windows", _cut_folder("windows.parquet"), lambda: [(CORPUS / "cut/windows.parquet").read_bytes()],
           (), 2),
    Reader("cut-part", _cut_folder("part.npz"), lambda: [(CORPUS / "cut/part.npz").read_bytes()], (), 2),
    Reader("checkpoint", _read_checkpoint, _good_checkpoint, (), 2),
    Reader("sweep", _file("own.toml", _specification), _good_specifications, (
        *_TOML, *_words("seeds program environment [grid] [sobol] samples 1:9:1 counts 'range' [1,2,'log'] settings")
    ), 30),
    Reader("sweep-results", _results, _stored("journal"), _words("null [] {} \"id\" \"error\" 1e400 NaN true"), 15),
    Reader("options", _options, _text(
        "0counts:open_target_share=0.1", "0fixed:feed_um_s=20", "1uhu:proportional_gain=600,E=400", "1servo-module",
        "212.5:30", "3ifStart=0.5:0.6", "45,10,20", "410:40:5", "4counts:a=1,b=2,voltage",
    ), _words("counts voltage fixed delay fuzzy : = , uhu eanpos P=1 .py policy: GapFeed-ppo 1:2:3 nan inf"), 150),
    Reader("qcl", devices.qcl, _stored("qcl", "examples/positioner/table.cnf", "examples/positioner/table.mod"),
           _words("IF ENDIF WAIT INIT Axis :st_init NOT OR AND JUMP ELSE EQ MAIN: END ( ) = + * / ; INTDEVICE INPUT "
                  "EANPOS F L"), 48),
    Reader("tape", devices.tape, _text(":0300300002337A1E\n:00000001FF\n", ":01000000AA55\n:00000001FF\n"),
           _words(":00000001FF :10 : 00 FF"), 170),
    Reader("uhu", devices.drive("uhu"), _text("P600\rI30\r#\rS1\rL1\r", "G100\rP\r600\rA\rZ\r", "+\rR\r?\r"),
           _words("P I D H X T N E M O C L S G A Z R + # ? 65535 65536 -32769"), 180),
    Reader("servo-module", devices.drive("servo-module"),
           _text("P1250\rM\rE100\rS\r", "Z12\rZ\r+100\r-5\r", "A\r?\rR\r"),
           _words("P I D E M S Z + - ? A R O X 65535 65536 -32769"), 180),
    Reader("elcam", devices.elcam,
           devices.good_calls, tuple(struct.pack("<d", v) for v in (0, 1, -1, 1e300, math.inf, math.nan)),
           60),
    Reader("compensation", _file("own.toml", _compensation), _stored("compensation"), _TOML, 29),
    Reader("terminal", devices.terminal, _text(
        "NEW 32520 32510\nTI 30 TP 100\nSTART\nWAIT 1\nSTOP\nGO\n",
        "TENSION LOW\nKEY 300 X+\nWAIT\nGEN ON\nEM\nWIRE\n",
        "POS 100 100\nCW 120 100 110 100\nTI 30 TP 100 SPEED 90\nSTART\nSTATUS\n",
        "G 0400\nTI 30 TP 100\nX 20\nPOS 1 1\nEM\nINIT\n", "LOAD A\nLIST\nRUN\n",
        "G 0400\nMON\nD 4000,4034\nS 4010 55\nG\nBYE\n",
    ), _words("TI TP NEW START STOP X Y GEN ON OFF SPEED CW CCW EM INIT WIRE LOAD LIST RUN GO WAIT TENSION KEY POS "
              "MAIN MON D S G R P H STATUS HELP ? BYE \x03 \x04 \x0b \x12 \x18 \x1c"), 4),
)  # fmt: skip
READERS = {reader.name: reader for reader in _ALL}
