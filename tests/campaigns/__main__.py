"""The campaign: ``python -m tests.campaigns [READER ...] --inputs 1000000 --out out/campaign``, or ``make campaign``.

Each reader has its share of the inputs and a process of its own; one that dies is noted with its input, and the next
input follows. ``--only N`` reads input N of a reader again, and shows what happens. Counts go to ``campaign.json``.
"""

import argparse
import json
import logging
import math
import os
import random
import resource
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

from .guard import judged
from .mutation import mutated
from .readers import READERS, Reader


def nth(reader: Reader, seed: int, n: int) -> bytes:
    """Return input n of a reader."""
    return mutated(random.Random(f"{seed} {reader.name} {n}"), reader.corpus, reader.words)


def run(reader: Reader, seed: int, inputs: int, out: Path) -> dict[str, Any]:
    """Read all inputs of a reader; processes that die are replaced."""
    began, done = time.monotonic(), 0
    total: Counter[str] = Counter()
    kinds: Counter[str] = Counter()
    cpu_s, held = 0.0, 0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as name:
        status_file = Path(name) / "told.json"
        while done < inputs:
            status_file.write_text("")
            child = os.fork()
            if child == 0:
                _child(reader, seed, (done, inputs), Path(name), status_file, out)
            _, status, usage = os.wait4(child, 0)
            last = json.loads(status_file.read_text().splitlines()[-1])
            total.update(last["counts"])
            kinds.update(last["kinds"])
            cpu_s, held = cpu_s + usage.ru_utime + usage.ru_stime, max(held, usage.ru_maxrss)
            done = last["done"]
            if status:
                kinds[f"the interpreter ended with status {status}"] += 1
                _keep(out, reader, done, nth(reader, seed, done))
                done += 1
    return {
        "inputs": done, **total, "found": dict(kinds), "cpu_s": round(cpu_s, 1), "peak_MB": round(held / 1024),
        "wall_s": round(time.monotonic() - began, 1), "seed": seed,
    }  # fmt: skip


def _child(reader: Reader, seed: int, span: tuple[int, int], folder: Path, status_file: Path, out: Path) -> None:
    status = 1
    try:
        # an input that ends the interpreter leaves the line of the one before it
        counts: Counter[str] = Counter()
        kinds: Counter[str] = Counter()
        logging.disable()  # ezdxf's warnings of every damaged drawing
        place = folder / "reads"
        place.mkdir(exist_ok=True)
        for good in reader.corpus:  # what is imported when it is first needed
            judged(reader.read, good, place)
        with status_file.open("w") as file:
            for n in range(*span):
                file.seek(0)
                file.write(json.dumps({"done": n, "counts": counts, "kinds": kinds}) + "\n")
                file.truncate()
                file.flush()
                data = nth(reader, seed, n)
                what, wrong = judged(reader.read, data, place)
                counts[what] += 1
                for kind in wrong:
                    kinds[kind] += 1
                    if kinds[kind] <= 3:
                        _keep(out, reader, n, data)
            file.seek(0)
            file.write(json.dumps({"done": span[1], "counts": counts, "kinds": kinds}) + "\n")
            file.truncate()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def _keep(out: Path, reader: Reader, n: int, data: bytes) -> None:
    (out / f"{reader.name}-{n}.bin").write_bytes(data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", help=", ".join(READERS))
    parser.add_argument("--inputs", type=int, default=1_000_000, help="of all readers together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/campaign"))
    parser.add_argument("--only", type=int, metavar="N")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.only is not None:
        reader = READERS[options.readers[0]]
        data = nth(reader, options.seed, options.only)
        print(repr(data[:2000]))
        with tempfile.TemporaryDirectory() as name:
            reader.read(data, Path(name))
        return
    file = options.out / "campaign.json"
    shares = sum(reader.share for reader in READERS.values())
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for name in options.readers or READERS:
        reader = READERS[name]
        found = run(reader, options.seed, math.ceil(options.inputs * reader.share / shares), options.out)
        known = json.loads(file.read_text()) if file.exists() else {}
        file.write_text(json.dumps({**known, name: found}, indent=1) + "\n")
        print(name, json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
