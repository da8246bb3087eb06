"""A made-up cut: a 10 x 6 mm rectangle, 3000 windows, with every quantity of a plausible size."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
import shapely

from edmsim.closed_loop.passes import Sums
from edmsim.machine.machine import Machine
from edmsim.metrology.profile import CornerError
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK
from edmsim.recording.report import Corner, Kerf, Origin, ProfileErrors, Report, Surface, Totals, build_report
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.rerun.write import write_recording
from edmsim.recording.scene import ErrorMap, Scene, polylines
from edmsim.recording.windows import ROW_NAMES, Closeups, Frames, WindowTable

N_WINDOWS = 3000
N_SLICES = 9
N_RAYS = 32
CORNERS_MM = np.array([(20.0, 20.0), (30.0, 20.0), (30.0, 26.0), (20.0, 26.0)])
START_MM = np.array([19.0, 19.0])
OFFSET_MM = 0.155
GAS = np.linspace(0.0, 0.6, N_SLICES)
"""Share of the wire's front under gas, per slice."""
NOTHING = Scene((), (), (), np.zeros((0, 2)), (0, 0, 10, 80), 20.0, (-10, 30), 250.0)
"""What a cut left that did nothing."""
LEAD = np.array([[path_um, 4.0, 0.0, -10.0, 30.0] for path_um in (0.0, 1e6)])
"""`Scene.lead` of a wire that leads its lower guide by 0.1 mm per mm of height over -10 mm, 2 mm at mid height."""


def changed(windows, **columns):
    """Return a table of windows with other values in some columns."""
    for name, values in columns.items():
        at = windows.column_names.index(name)
        windows = windows.set_column(at, windows.schema.field(at), pa.array(values))
    return windows


def table_of(rows):
    """Return a table of windows of which only some values matter; the others are 0."""
    table = WindowTable()
    for row in rows:
        table.append([row.get(name, 0.0) for name in ROW_NAMES])
    return table.to_arrow()


def closeups_of(rows, **values):
    """Return a store of some close-ups with other values in some of their fields."""
    store = Closeups(N_SLICES, N_RAYS, N_SLICES // 2)
    for row in rows:
        for name in row.dtype.names:
            store.row[name] = values.get(name, row[name])
        store.keep()
    return store


def texts(figure):
    """Return all texts of a figure, a line each."""
    return "\n".join(text.get_text() for text in figure.findobj(match=lambda a: hasattr(a, "get_text")))


def wire_path():
    """Wire centre in mm: from the start hole round the rectangle, the part on its left."""
    outer = CORNERS_MM + OFFSET_MM * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    return np.vstack([START_MM, outer, outer[:1]])


def along(points, s):
    """Points at the lengths `s` of a polyline."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    return np.column_stack([np.interp(s, length, points[:, axis]) for axis in (0, 1)])


def error_map(draw):
    nominal = np.vstack([CORNERS_MM, CORNERS_MM[:1]])
    s = np.arange(0.0, 32.0, 0.02)
    to_corner = np.abs(s[:, None] - np.array([0.0, 10.0, 16.0, 26.0, 32.0])).min(axis=1)
    error = 2.0 * np.sin(s) - 9.0 * np.exp(-to_corner / 0.15) + 0.4 * draw.standard_normal(len(s))
    return ErrorMap(nominal, "left", along(nominal, s), error, np.outer([0.1, 0.1, 0.2, 0.4, 0.2], error))


def windows(draw):
    path = wire_path()
    total_um = 1000.0 * np.hypot(*np.diff(path, axis=0).T).sum()
    path_um = total_um * np.linspace(0.0, 1.0, N_WINDOWS) ** 1.05
    place_um = np.round(1000.0 * along(path, path_um / 1000.0))
    direction = np.gradient(place_um, axis=0)
    direction /= np.maximum(np.hypot(*direction.T)[:, None], 1e-9)
    lag_um = 4.0 + 0.5 * draw.standard_normal(N_WINDOWS)
    table = WindowTable()
    for i in range(N_WINDOWS):
        counts = draw.multinomial(255, (0.03, 0.40, 0.55, 0.02))
        table.append(
            (
                0.55 * (i + 1),
                *place_um[i],
                20.0 + 3.0 * np.sin(i / 150) + draw.standard_normal(),
                *counts,
                55.0 + draw.standard_normal(),
                1.4 + 0.05 * draw.standard_normal(),
                np.nan if i % 500 == 0 else 12.0 + draw.standard_normal(),
                16.0 + draw.standard_normal(),
                *(lag_um[i] * direction[i]),
                0.0,
                0.0,
                330.0 + 20.0 * np.sin(i / 300),
                0.01 + 0.001 * draw.standard_normal(),
                0.3 + 0.02 * np.sin(i / 200),
                30.0,
                100.0,
                path_um[i],
            )
        )
    return table


def frames(rows):
    store = Frames(N_SLICES)
    shape = np.sin(np.pi * (np.arange(N_SLICES) + 0.5) / N_SLICES)
    for row in rows:
        store.offer(row[0], row[1:3], row[-1], -shape[:, None] * row[12:14], GAS)
    return store


def closeups(rows):
    """Every window's pulses: spark, open, short, arc by turns, all in the middle slice, along ray 0 (+x)."""
    store = Closeups(N_SLICES, N_RAYS, N_SLICES // 2)
    number = np.arange(96)
    for row in rows:
        r, p = store.row, store.row["pulses"]
        r["t_s"], r["guides_um"], r["path_um"] = row[0], row[1:3], row[-1]
        r["burning_V"], r["current_A"], r["short_A"] = 22.0, 6.6, 8.0
        r["wire_um"] = row[1:3] - row[12:14]
        r["walls_um"] = np.where(np.arange(N_RAYS) < N_RAYS // 2, 15.0, 1e6)
        r["deflection_um"], r["coverage"] = -row[12:14], GAS
        p["kind"] = np.array([SPARK, OPEN, SHORT, ARC])[number % 4]
        p["start_us"], p["open_V"] = 100.0 * number, 100.0
        p["delay_us"] = np.array([10.0, 30.0, 0.0, 0.0])[number % 4]
        p["conducting_us"] = np.array([20.0, 0.0, 30.0, 30.0])[number % 4]
        p["slice"] = np.where(number % 4 == 1, -1, N_SLICES // 2)
        p["gap_um"] = np.where(number % 4 == 2, 0.0, 15.0)
        p["x_um"], p["y_um"] = r["wire_um"]
        r["count"] = len(number)
        store.keep()
    return store


def cut_edges(stop=None):
    wire = shapely.LineString(wire_path())
    kerfs = [
        wire.buffer(0.153 + 0.002 * np.sin(np.pi * k / (N_SLICES - 1)), join_style="round")
        for k in range(N_SLICES)
    ]
    return tuple(polylines(kerf.union(shapely.Point(START_MM).buffer(0.5)).boundary) for kerf in kerfs)


@pytest.fixture(scope="session")
def cut():
    """Everything recorded and measured of the made-up cut."""
    draw = np.random.default_rng(7)
    table = windows(draw)
    edge = error_map(draw)
    corners = tuple(
        CornerError(float(x), float(y), 90.0, e)
        for (x, y), e in zip(CORNERS_MM, (-9.1, -8.4, -10.2, -7.9), strict=True)
    )
    scene = Scene(
        maps=(edge,), cut_edges_mm=cut_edges(), corners=corners, starts_mm=START_MM[None, :],
        stock_mm=(15.0, 15.0, 35.0, 31.0), height_mm=20.0, guides_z_mm=(-15.0, 35.0), wire_diameter_um=250.0,
        holes_mm=np.array([[*START_MM, 0.5]]), origin_mm=(20.0, 20.0),
    )  # fmt: skip
    arrow = table.to_arrow(4.0 * np.sin(np.arange(N_WINDOWS) / 200))
    totals = Totals(
        machining_time_s=1650.0, wall_time_s=41.0,
        sums=Sums(90_000, 1_200_000, 1_650_000, 60_000, energy=1800.0, vibration2_pulses=0.64 * 3_000_000),
        path_length_mm=33.2, cut_area_mm2=33.2 * 20.0, cutting_time_s=1500.0, removed_mm3=205.0,
    )  # fmt: skip
    part = Report(
        origin_mm=Origin(20.0, 20.0), kerf_um=Kerf(308.0, 301.0, 314.0),
        profile_error_um=ProfileErrors(10.2, 2.1, 4.0),
        corners=[Corner(c.x_mm - 20.0, c.y_mm - 20.0, c.x_mm, c.y_mm, c.turn_deg, c.error_um) for c in corners],
        surface=Surface(1.9),
    )  # fmt: skip
    report = build_report(
        part, arrow, totals, outcome="finished", reason=None, notices=["made up"], seed=7,
        settings={"program": "rectangle.ngc", "controller": "counts", "unit": None, "heights": []}, version="0.0.0",
    )  # fmt: skip
    return SimpleNamespace(
        table=table, windows=arrow, frames=frames(table.rows), closeups=closeups(table.rows),
        machine=Machine.load(height_mm=20.0), scene=scene, totals=totals, part=part, report=report,
    )  # fmt: skip


@pytest.fixture(scope="session")
def record(cut):
    """Return a function that writes a recording of the made-up cut into a file; some of the cut may be changed."""

    def write(file, **changed):
        names = ("scene", "windows", "frames", "closeups", "machine", "report")
        arguments = {name: getattr(cut, name) for name in names} | changed
        write_recording(file, **arguments, title="punch.ngc")
        return file

    return write


@pytest.fixture(scope="session")
def recording(record, tmp_path_factory):
    """The recording of the made-up cut, not to be changed."""
    return record(tmp_path_factory.mktemp("recording") / "cut.rrd")


@pytest.fixture(scope="session")
def empty_recording(cut, record, tmp_path_factory):
    """The recording of a cut without windows, not to be changed."""
    scene = dataclasses.replace(cut.scene, cut_edges_mm=())
    return record(
        tmp_path_factory.mktemp("empty") / "cut.rrd", windows=WindowTable().to_arrow(), frames=Frames(N_SLICES),
        closeups=Closeups(N_SLICES, N_RAYS, N_SLICES // 2), scene=scene,
    )  # fmt: skip


@pytest.fixture(scope="session")
def play(recording):
    return Playback(recording)


@pytest.fixture(autouse=True)
def pictures_of_cuts():
    """Draw all pictures, in place of what the fixture of this name leaves out elsewhere."""
