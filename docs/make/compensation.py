"""The picture of cam-tables.md, figures/compensation.png: a worn table and a punch, with and without compensation.

python docs/make/compensation.py
"""

import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from sections import DOCS

import edmsim
from edmsim.controllers.axis.elcam.file import load_tables, text_of
from edmsim.measure import measure_table, part_figure

PERFECT = (
    'title = "worn-table without its errors"\nlike = "agiecut-dem15"\n'
    '[table]\nstep_um = {value = 1.0, source = "as worn-table"}\n'
)


def main() -> None:
    """Measure the table, make three cuts, and write the picture."""
    worn = edmsim.Machine.load("worn-table")
    before = measure_table(worn, seed=1)
    after = measure_table(worn, seed=2, compensation=load_tables(before.tables()))
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(2) as pool:
        tables, perfect = Path(name) / "tables.toml", Path(name) / "perfect.toml"
        tables.write_text(text_of(before.tables()), encoding="utf-8")
        perfect.write_text(PERFECT, encoding="utf-8")
        cuts = {
            "perfect table": {"machine": str(perfect)}, "as it is": {"machine": "worn-table"},
            "compensated": {"machine": "worn-table", "compensation": str(tables)},
        }  # fmt: skip
        punch = DOCS.parent / "examples" / "punch.ngc"
        made = {
            kind: pool.submit(edmsim.cut, punch, height_mm=3.0, resolution="fast", seed=1, **options)  # type: ignore[arg-type]
            for kind, options in cuts.items()
        }
        maps = {kind: future.result().scene.maps[0] for kind, future in made.items()}
    figure = part_figure({"as it is": before, "compensated": after}, maps)
    figure.savefig(DOCS / "figures" / "compensation.png", dpi=110)


if __name__ == "__main__":
    main()
