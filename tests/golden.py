"""Record results of the product, item by item, and compare two recordings: a refactoring must keep every bit.

    python tests/golden.py record FOLDER [--only G1,G3]     record this checkout, into FOLDER/G1.json ...
    python tests/golden.py compare OLD NEW [--only G1,G3]   a line for every item that differs; exit status 1 if any

An item is a digest of the whole value and a short text of it: numbers here and there, a message, a transcript.
Times of the computer's clock, the version, and the names of folders are left out.
"""

import argparse
import hashlib
import io
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from rerun.chunk import RrdReader

# the only imports that depend on the modules of the product
import edmsim
from edmsim import Machine, Plant, PulseWindow, controllers, envs, validation
from edmsim.cli import app as cli
from edmsim.controllers.planner.registry import PLANNERS, make_planner
from edmsim.envs.registry import registered_ids
from edmsim.metrology.edges import contour
from edmsim.plant.workpiece.blanks import started_slot
from edmsim.validation.setups import FRAIL, altered

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = dict(pair.split("=") for pair in f"""EDMSIM_GOLDEN={ROOT} PYTHONPATH={ROOT} PYTHONSAFEPATH=1 COLUMNS=100
    PYTHONHASHSEED=0 PYTHONWARNINGS=ignore TERM=dumb NO_COLOR=1 MPLBACKEND=agg MUJOCO_GL=disable OMP_NUM_THREADS=1
    CUDA_VISIBLE_DEVICES= XDG_CACHE_HOME={tempfile.gettempdir()}/edmsim-golden-cache""".split())  # fmt: skip
"""Environment variables of a recording; it has a cache of its own, so that no other checkout's is evicted."""
LEFT_OUT = frozenset({"wall_time_s", "realtime_factor", "edmsim_version"})
MASKED = re.compile(r"computed in [^)<]*|<footer>edmsim [^<]*|\"edmsim_version\": \"[^\"]*\"|\(\d+\.\d+\.\d+\)")
LONGEST, SAMPLES = 20_000, 24
Items = dict[str, list[str]]
CENTRE_UM = (32_500.0, 32_500.0)
IDS = tuple(env_id for env_id in registered_ids() if "Part" not in env_id)  # G2 records cuts of parts
FILES = {
    "punch.ngc": "G21 G90\nG0 X-2.5 Y0.5\nG41 D1\nG1 X0 Y0.5\nY1\nX1\nY0\nX0\nY0.5\nG40\nM2\n",
    "dwell.ngc": "G0 X0 Y0\nG1 X0.101\nG4 P3\nG1 Y0.203\nG4 P1\nG2 X0.2 Y0.302 I0.099 J0\nG1 X0\nM2\n",
    "two.ngc": "G0 X0 Y0\nG1 X0.12\nY0.08\nG0 X3 Y2\nG1 X3.1\nG3 X3.2 Y2.1 I0 J0.1\nM2\n",
    "bad-word.ngc": "G0 X0 Y0\nG1 X5\nG1 X6 V3\n", "bad-arc.ngc": "G0 X0 Y0\nG1 X5\nG2 X7 Y3 I2 J2\n",
    "bad-code.ngc": "G1 X5\nG77 X6\n", "bad-size.ngc": "G0 X0\nG1 X66.0\n", "bad-none.ngc": "", "bad.txt": "G1 X3\n",
    "host.txt": "* a round end\nTI 30 TP 100 SPEED 120\nNEW 1300 1000\nTI 20\nCCW 1300 1100 1300 1050\nEND\n",
    "own.py": "from edmsim import controllers\nclass Own(type(controllers.make('fixed'))):\n    name = 'own'\n",
}  # fmt: skip
"""Files in the folder in which a group is recorded."""
SESSIONS = {
    "": "HELP|STATUS|X -20|WAIT|POS 1000 1000|TI 30 TP 100 SPEED 110|NEW 1200 1000|START|WAIT 5|STATUS|WAIT|MAIN||"
        "1100 1000|20|100||YES|WAIT|STATUS|BYE",
    "--seed 4": "TI 30|TI 40 TP 100|TI 30 TP 100|FOO|NEW 1 70000|NEW 32700 32500|START|X 20|WAIT 3|EM|X 20|INIT|GO|"
                "TI 30 TP 100|GO|WAIT 2|\x03|INIT|X 1200|WAIT|INIT|X -1200|WAIT|WIRE|STATUS",
    "--host host.txt": "LOAD|LIST|POS 1000 1000|RUN|WAIT|STATUS|BYE",
    "--fault serial-noise --fault drop-out": "X 100|WAIT|TI 30 TP 100|GEN ON|WAIT 0|STATUS|STATUS|GEN OFF|X -60|WAIT|"
                                             "TI 10 TP 60|NEW 32900 32500|START|WAIT 20|STATUS",
    "--planner dda --tension 9": "X 36|WAIT|TI 06H TP FFH|NEW 33000 32500|START|WAIT 60|STATUS",
}  # fmt: skip
REFUSED = f"""|saw|cut|cut punch.ngc|cut no.ngc --out o|cut no.dxf --out o|cut punch.ngc --out bad.txt/o|view|view .
evaluate no|evaluate {IDS[0]} --seeds 1|evaluate {IDS[0]} --controllers no|evaluate own.py:no|train no --out o|view no
train {IDS[0]} --out o --score 1|train {IDS[0]} --out o --algo no|train {IDS[0]} --out o --resume|view no .
report no|report . --format bmp|report .|report . --film a.gif|console 1982 --machine no|console 1982 --speed 0
console 1982 --fault no|console 1982 --planner no|console 1982 --host no|calibrate bad.txt --out o.toml|validate no
calibrate no.csv --out no/o.toml|bench --figure no|--help|cut --help|evaluate --help|console 1982 --help"""
CUT_WITH = """--material no|--machine no|--machine no.toml|--wire brass-10|--generator no|--planner no|--drive no
--controller no|--controller fixed:feed_um_s=99|--controller oracle|--controller fixed:feed=1|--mechanics no|--resume
--controller fixed:feed_um_s=x|--controller no.py:Own|--controller own.py|--controller policy:no|--resolution no
--tension 60|--tension 0|--height -4|--height abc|--height-at 5;30|--height-at 3:6 --height-at 2:7|--height-at 99:6
--t-on 40|--t-period 0|--offset wide|--max-time 0|--colour red"""


def take(items: Items, name: str, make: Callable[..., Any], *arguments: Any, **options: Any) -> None:
    """Record what a call returns, or its error; print its name and duration."""
    start_s, text = time.perf_counter(), ""
    try:
        put(items, name, make(*arguments, **options))
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        put(items, f"{name}/error", {"told": text, **vars(error)})
    print(f"{name}  {time.perf_counter() - start_s:.1f} s  {text}", flush=True)


def put(items: Items, name: str, value: Any) -> None:
    """Record a value: mappings, tables, records and lists of records field by field."""
    if hasattr(value, "column_names"):
        value = {"schema": str(value.schema), **{c: value.column(c).to_numpy() for c in value.column_names}}
    elif isinstance(value, np.ndarray) and value.dtype.names:
        value = {field: value[field] for field in value.dtype.names}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    elif isinstance(value, list) and value and all(hasattr(row, "_asdict") for row in value):
        value = {field: [getattr(row, field) for row in value] for field in value[0]._fields}
    if isinstance(value, Mapping):
        for key in [key for key in value if key not in LEFT_OUT]:
            put(items, f"{name}/{key}", value[key])
    else:
        items[name] = entry(value)


def entry(value: Any) -> list[str]:
    """Return the digest and a text of a value without fields."""
    if isinstance(value, list):
        with suppress(ValueError, OverflowError):  # lists of unequal lengths, or too large integers
            array = np.array(value)
            value = array if array.dtype.kind in "biuf" else value
    if isinstance(value, np.ndarray) and value.dtype != object:
        text = f"{value.dtype}{value.shape} {value.ravel()[:: max(1, value.size // SAMPLES)].tolist()}"
        return [hashlib.sha256(text.encode() + value.tobytes()).hexdigest(), text]
    text = value if isinstance(value, str) else json.dumps(value, default=lambda v: getattr(v, "tolist", v.__str__)())
    text = MASKED.sub("<masked>", text.replace(os.getcwd(), "<folder>").replace(str(ROOT), "<root>"))
    return [hashlib.sha256(text.encode()).hexdigest(), text[:LONGEST]]


def command(text: str, folder: str | None = None) -> dict[str, Any]:
    """Run a command line in this process; returns status and output, or the files of a folder in place of errors."""
    out, err, status = io.StringIO(), io.StringIO(), None
    sys.argv = ["edmsim", *text.split()]
    with redirect_stdout(out), redirect_stderr(err):
        try:
            cli.main()
        except SystemExit as left:
            status = left.code
    outcome: dict[str, Any] = {"status": status, "out": out.getvalue(), "err": "" if folder else err.getvalue()}
    for file in sorted(Path(folder).rglob("*")) if folder else ():
        if file.suffix == ".npz":
            outcome[file.name] = dict(np.load(file))
        elif file.suffix in (".png", ".gif"):
            outcome[file.name] = np.fromfile(file, np.uint8)
        elif file.suffix in (".html", ".toml", ".json"):
            outcome[file.name] = json.loads(file.read_text()) if file.suffix == ".json" else file.read_text()
        elif file.suffix == ".rrd":
            for batch in (chunk.to_record_batch() for chunk in RrdReader(file).stream().to_chunks()):
                entity = batch.schema.metadata[b"rerun:entity_path"].decode()
                for name in {*batch.schema.names} - {"log_time", "log_tick", "rerun.controls.RowId"}:
                    outcome.setdefault(f"{entity} {name}", []).extend(batch.column(name).to_pylist())
    # /made_by is the version
    return {name: outcome[name] for name in sorted(outcome) if not name.startswith("/made_by")}


def driven(plant: Plant, windows: int, step_ns: int = 100_000_000, axis: int = 0) -> list[PulseWindow]:
    """Advance with motor steps of 2 um at equal intervals; stop early if the wire breaks."""
    done: list[PulseWindow] = []
    while len(done) < windows and not (done and done[-1].broken):
        times = range(-(-plant.time_ns // step_ns) * step_ns, plant.time_ns + plant.longest_window_ns, step_ns)
        done.append(plant.advance([(t, axis, 1) for t in times]))
    return done


def slotted(resolution: str = "fast", mechanics: str = "modal", altering: Any = None, **options: Any) -> Plant:
    """Return a plant whose wire is at the end of a partly cut slot."""
    machine = altered(Machine.load(**options), altering or {})
    stock = started_slot(machine, CENTRE_UM)
    return Plant(machine, 1, stock=stock, position_um=CENTRE_UM, resolution=resolution, mechanics=mechanics)


def plant_run(windows: int, turn: Callable[[Plant], Any] | None = None, **options: Any) -> dict[str, Any]:
    """Return a plant after some windows, a call of `turn`, which may return another plant, and further windows."""
    plant = slotted(**options)
    first, turned = driven(plant, windows), turn(plant) if turn else None
    if isinstance(turned, Plant):
        plant, turned = turned, None
    after = driven(plant, 50) if turn else None
    names = ("time_ns", "place_um", "longest_window_ns", "removed_mm3", "craters_mm3", "broken_height_mm", "timing")
    called = {"deflections_um": plant.deflections_um(), "rays": plant.rays(), "walls_um": plant.walls_um(1)[1]}
    return {"windows": first, "turn": turned, "after": after, "machine": plant.machine.model_dump_json(indent=1),
            "snapshot": plant.snapshot(), **called, **{name: getattr(plant, name) for name in names}}  # fmt: skip


def record_plant(items: Items) -> None:
    """G1: windows and snapshots."""
    for windows, resolution, mechanics in ((800, "fast", "modal"), (150, "default", "modal"), (60, "fine", "modal"),
                                           (24, "fast", "mujoco"), (12, "default", "mujoco"), (8, "fine", "mujoco")):
        take(items, f"{resolution} {mechanics}", plant_run, windows, resolution=resolution, mechanics=mechanics)
    for options in ({"generator": "iso-energetic"}, {"generator": "ignition-pulse"}, {"wire": "copper-100"},
                    {"material": "copper", "height_mm": 60.0}, {"material": "cemented-carbide", "tension": 8.0},
                    {"material": "aluminium", "wire": "molybdenum-150", "t_on_us": 15.0}, {"altering": FRAIL}):
        take(items, f"set-up {options}", plant_run, 200, **options)
    turns: dict[str, Callable[[Plant], Any]] = {
        "new setting": lambda p: p.set_generator(20.0, 80.0), "reset": lambda p: p.reset(7), "straight": lambda p: p,
        "off": lambda p: p.switch_generator(False), "pickled": lambda p: pickle.loads(pickle.dumps(p)),
        "off and on": lambda p: [p.switch_generator(False), driven(p, 20, axis=1), p.switch_generator(True)][1],
        "new wire": lambda p: p.rethread((CENTRE_UM[0] - 5.0, CENTRE_UM[1]), 60 * 10**9),
        "pulse by pulse": lambda p: [p.advance_pulse([(p.time_ns, 0, 1)] * (k % 60 == 0)) for k in range(300)],
        "watched": lambda p: [p.watch_pulses(), *(p.last_pulses() for _ in range(5) if driven(p, 1))][-1],
        "restored": lambda p: [other := slotted(), other.restore(p.snapshot())][0],
    }  # fmt: skip
    for name, turn in turns.items():
        take(items, name, plant_run, 100, turn)
    take(items, "out of range", driven, slotted(), 3_000, 2_000_000)
    plant = slotted()
    for steps in ([(0, 2, 1)], [(0, 0, 2)], [(-1, 0, 1)], [(0, 0)], [(9, 0, 1), (5, 0, 1)]):
        take(items, f"steps {steps}", plant.advance, steps)
    take(items, "wrong setting", plant.set_generator, 40.0, 100.0)
    for wrong in (("coarse",), ("fast", "steam"), ("fast", "modal", {"base.none": 1.0})):
        take(items, f"wrong {wrong}", slotted, *wrong)


def cut(program: str, **options: Any) -> dict[str, Any]:
    """Cut a program, by default at coarse resolution and for a short time; return all results of the cut."""
    observed: list[Any] = []
    settings: Any = {"resolution": "fast", "seed": 1, "max_time_s": 30.0, "watch": observed.append, **options}
    result = edmsim.cut(program, **settings)
    slices = 0, result.frames.n_slices // 2
    contours = {str(k): np.frombuffer(contour(result.field, k).wkb, np.uint8) for k in slices}
    path = {str(k): leg.points_um for k, leg in enumerate(result.path.contours)}
    frames = {name: result.frames.rows[name] for name in ("t_s", "guides_um", "path_um", "deflection_um")}
    return {"report": result.report, "windows": result.windows, "frames": frames, "path": path,
            "closeups": result.closeups.table(), "contours": contours, "progress": observed}  # fmt: skip


def steps_of(planner: str, nm_s: float, unit: Any) -> dict[str, Any]:
    """Follow a random polyline at random speeds."""
    rng = np.random.default_rng(5)
    points = 2 * np.cumsum(rng.integers(-40, 41, (12, 2)), axis=0) + 30_000
    made, steps, places = make_planner(planner, points, nm_s, unit), list[Any](), list[Any]()
    for window, speed in enumerate([*rng.choice([0, 127, 60, 20, -40, -127, 90], 800).tolist(), *[127] * 900]):
        steps += made.advance(window * 25_500_000, (window + 1) * 25_500_000, speed)
        places.append((made.path_um, *made.position_um, made.done))
    return {"steps": steps, "places": places}


def record_cuts(items: Items) -> None:
    """G2: whole cuts with their files, and the planners alone."""
    area = ([(-0.5, -2.0), (9.0, -2.0), (9.0, 9.0), (3.0, 9.0)], 11.0)
    controlled = [name for name in controllers.names() if name != "oracle"]
    controlled += ["policy:GapFeed-ppo", "policy:Contour-ppo", "fixed:feed_um_s=20", "own.py:Own:feed_um_s=25"]
    cuts: list[tuple[str, dict[str, Any]]] = [
        ("punch.ngc", {"max_time_s": None, "height_mm": 5.0, "out": "whole"}),
        ("dwell.ngc", {"mechanics": "mujoco", "max_time_s": 1}), ("two.ngc", {"max_time_s": None, "offset": "none"}),
        *((f"{ROOT}/examples/{name}", {}) for name in ("punch.ngc", "slot.iso", "gear.dxf")),
        *(("dwell.ngc", {"planner": name, "max_time_s": None, "offset": "none"}) for name in PLANNERS),
        *(("punch.ngc", {"controller": name}) for name in controlled),
        *(("punch.ngc", options) for options in (
            {"heights": [(0.3, 12.0), (0.6, 8.0)]}, {"height_areas": [area]}, {"generator": "iso-energetic"},
            {"resolution": "default", "max_time_s": 15.0}, {"controller": controllers.make("fixed", feed_um_s=30.0)},
            {"resolution": "fine", "max_time_s": 12.0, "height_mm": 40.0}, {"material": "copper", "seed": 12},
            {"generator": "ignition-pulse", "controller": "fixed:feed_um_s=12"}, {"wire": "molybdenum-150"},
            {"tension": 9.0, "t_on_us": 15.0, "t_period_us": 120.0, "offset": 0.1},
        )),
    ]  # fmt: skip
    for program, options in cuts:
        take(items, f"{Path(program).name} {options}", cut, program, **options)
    take(items, "files", command, "report whole", "whole")
    take(items, "figures", command, "report whole --figures figures --format png", "figures")
    take(items, "film", command, "render whole --out figures/cut.gif --seconds 0.5", "figures")
    for name in PLANNERS:
        for nm_s, unit in ((262.5, "um"), (252.6, "um"), (262.5, "step")):
            take(items, f"steps of {name} {nm_s} {unit}", steps_of, name, nm_s, unit)


def resumed(stop_s: float, program: str, **options: Any) -> dict[str, Any]:
    """Interrupt a cut at a machine time by Ctrl-C, and resume it; if the time is 0, do not interrupt it."""
    if not stop_s:
        return {"cut": {**cut(program, **options), "progress": None}}
    folder = Path(f"{program}-{stop_s}-{len(options)}")
    with suppress(KeyboardInterrupt):
        cut(program, out=folder, watch=lambda p: p.time_s < stop_s or signal.default_int_handler(2, None), **options)
    files = sorted(file.name for file in folder.iterdir())
    return {"files": files, "cut": {**cut(program, out=folder, resume=True, **options), "progress": None}}


def record_resumed(items: Items) -> None:
    """G3: resumed cuts, and their differences from the uninterrupted cut."""
    for program, options in (("punch.ngc", {}), ("dwell.ngc", {"max_time_s": None, "offset": "none"}),
                             ("punch.ngc", {"controller": "mcu", "planner": "dda", "generator": "iso-energetic"})):
        names = {stop_s: f"{program} {options} at {stop_s}" for stop_s in (0, 1.0, 8.0, 14.0)}
        for stop_s, name in names.items():
            take(items, name, resumed, stop_s, program, **options)
        cuts = [{key[len(n) :]: items[key] for key in items if key.startswith(f"{n}/cut/")} for n in names.values()]
        differing = {key for one in cuts for key in {**cuts[0], **one} if one.get(key) != cuts[0].get(key)}
        put(items, f"{program} {options} differs from the straight one in", json.dumps(sorted(differing)))


def played(env: Any, actions: Iterable[Any], **reset: Any) -> dict[str, Any]:
    """Step through actions, after a reset if it has arguments; reset a single environment after an episode's end."""
    (first, drawn), rows = env.reset(**reset) if reset else (None, None), list[Any]()
    for action in actions:
        rows.append(env.step(action))
        if rows[-1][2] is True:
            env.reset()
    observed, rewards, ended, cut_off, infos = (list(column) for column in zip(*rows, strict=True))
    columns = {key: [info.get(key) for info in infos] for key in sorted({key for info in infos for key in info})}
    return {"begun": first, "drawn": drawn, "seen": observed, "rewards": rewards, "over": [ended, cut_off],
            "infos": columns}  # fmt: skip


def task_cut(env_id: str, windows: int) -> list[Any]:
    """Run an episode of an environment with the controller `counts`."""
    task, law = envs.Task(env_id, resolution="fast", planner="exact"), controllers.make("counts")
    results: list[Any] = []
    task.reset(seed=8)
    order = law.reset(task.max_feed_um_s)
    while len(results) < windows and not (results and results[-1].over):
        results.append(task.advance(order.feed_um_s, order.t_on_us, order.t_period_us))
        order = law.update(results[-1].observation)
    return results


def record_environments(items: Items) -> None:
    """G4: every environment as a vector, alone, copied in mid-episode, and as a task."""
    chosen: dict[str, Any] = {"resolution": "fast", "planner": "exact"}
    vector: dict[str, Any] = {"num_envs": 4, "vectorization_mode": "vector_entry_point", **chosen}
    for env_id in IDS:
        envs = gymnasium.make_vec(env_id, **vector)
        one = gymnasium.make(env_id, render_mode="rgb_array", **chosen)
        actions = np.random.default_rng(3).uniform(-0.4, 1.0, (400, 4, *one.action_space.shape)).astype(np.float32)
        take(items, f"{env_id} vector", played, envs, actions[:200], seed=11)
        take(items, f"{env_id} one", played, one, actions[:60, 0], seed=11)
        take(items, f"{env_id} picture", one.render)
        for name, env, more in (("vector", envs, actions[200:]), ("one", one.unwrapped, actions[60:90, 0])):
            take(items, f"{env_id} {name} copied", played, pickle.loads(pickle.dumps(env)), more)
            take(items, f"{env_id} {name} on", played, env, more)
        take(items, f"{env_id} task", task_cut, env_id, 400)
    envs = gymnasium.make_vec(IDS[0], **vector, max_episode_steps=15, autoreset_mode="SameStep")
    take(items, "short episodes", played, envs, actions[:60, :, :1], seed=[4, 9, 2, 7])


def record_terminal(items: Items) -> None:
    """G5: sessions in a pipe, character by character."""
    for options, lines in SESSIONS.items():
        words = [sys.executable, *f"-m edmsim console 1982 --resolution fast --height 5 {options}".split()]
        done = subprocess.run(words, input=f"{lines}|".replace("|", "\n").encode(), capture_output=True, check=False)
        text = {"out": done.stdout.decode("latin-1"), "err": done.stderr.decode("latin-1")}
        take(items, f"terminal {options}", dict, text, status=done.returncode)


def record_studies(items: Items) -> None:
    """G6: small runs of commands that make many cuts."""
    for words in (f"{IDS[0]} --controllers counts,voltage --json", f"{IDS[1]} --controllers fixed"):
        take(items, f"evaluate {words}", command, f"evaluate {words} --seeds 2 --resolution fast")
    for check in validation.checks([name for name in validation.MODULES if name != "ignition"]):  # the slowest
        take(items, f"validate {check.__name__}", lambda check=check: {row.name: vars(row) for row in check((1, 2))})
    take(items, "log", cut, "punch.ngc", out="log", height_mm=5.0)
    fit = "--fit material.removal_mm3_J --height 5 --json"
    take(items, "calibrate", command, f"calibrate log/windows.parquet --out log/own.toml {fit}", "log")
    take(items, "train", command, f"train {IDS[0]} --steps 512 --score 0 --seed 3 --out trained", "trained")


def record_refusals(items: Items) -> None:
    """G7: messages for bad usage and bad input, and the help."""
    cuts = [f"cut punch.ngc --out o {words}" for words in re.split(r"[|\n]", CUT_WITH)]
    for text in (*re.split(r"[|\n]", REFUSED), *cuts, *(f"cut {name} --out o" for name in FILES if "bad" in name)):
        take(items, f"edmsim {text}", command, text)
    take(items, "left behind", lambda: sorted({file.name for file in Path().iterdir()} - set(FILES)))
    for options in ({"colour": "red"}, {"history": 0}, {"render_mode": "ansi"}):
        take(items, f"environment with {options}", gymnasium.make, IDS[0], **options)
    take(items, "no name", getattr, edmsim, "nothing")


GROUPS = dict(zip(("G1", "G2", "G3", "G4", "G5", "G6", "G7"), (
    record_plant, record_cuts, record_resumed, record_environments, record_terminal, record_studies, record_refusals,
), strict=True))  # fmt: skip


def compare(group: str, old: Path, new: Path) -> int:
    """Print a line for every item that differs; returns their number."""
    one, other = (json.loads((folder / f"{group}.json").read_text(encoding="utf-8")) for folder in (old, new))
    unequal = [name for name in dict.fromkeys([*one, *other]) if one.get(name) != other.get(name)]
    for name in unequal:
        a, b = (items.get(name, ["", "missing"])[1] for items in (one, other))
        at = max(len(os.path.commonprefix([a, b])) - 60, 0) if len(a + b) > 200 else 0  # noqa: RUF071 - of texts
        print(f"{group} {name}: {a[at : at + 160]!r} -> {b[at : at + 160]!r}")
    print(f"{group}: {len(unequal)} of {len({*one, *other})} items differ")
    return len(unequal)


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--only", type=lambda text: text.split(","), default=[*GROUPS])
    arguments = parser.parse_args()
    if len(arguments.folders) != (1 if arguments.what == "record" else 2) or not set(arguments.only) <= set(GROUPS):
        parser.error(f"record FOLDER or compare OLD NEW; groups are {', '.join(GROUPS)}")
    if arguments.what == "compare":
        return int(sum(compare(group, *arguments.folders) for group in arguments.only) > 0)
    if os.environ.get("EDMSIM_GOLDEN") != str(ROOT):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **ENVIRONMENT})
    arguments.folders[0].mkdir(parents=True, exist_ok=True)
    for group in arguments.only:
        start_s, items = time.perf_counter(), Items()
        with tempfile.TemporaryDirectory(prefix="golden-") as folder, chdir(folder):
            for name, text in FILES.items():
                Path(name).write_text(text, encoding="utf-8")
            GROUPS[group](items)
        (arguments.folders[0] / f"{group}.json").write_text(json.dumps(items, indent=0), encoding="utf-8")
        print(f"{group}: {len(items)} items, {time.perf_counter() - start_s:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
