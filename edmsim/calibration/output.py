"""Outputs of a calibration: files for ``edmsim cut``, a table for the terminal, JSON for scripts."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import BaseModel
from rich.console import Group
from rich.text import Text

from edmsim import __version__, files, screen
from edmsim.calibration.fit import MUCH, Fit
from edmsim.calibration.log import STATISTICS
from edmsim.errors import InputError
from edmsim.machine import ranges
from edmsim.plant.resolution import RESOLUTIONS

STRONG = 0.95
"""Stronger correlations of errors are reported: the log determines a combination better than either (ours)."""


def write(fit: Fit, log_name: str, out: Path, extra_files: Iterable[str] = ()) -> dict[str, Path]:
    """Write the fitted set-up as new files, each replaced atomically; return them by options of ``edmsim cut``."""
    # `out` receives the machine's constants; files next to it receive those of material and wire, if any were fitted
    # or overridden in the cut of the log
    machine = ranges.with_constants(fit.machine, _with_sources(fit, log_name))
    # the diameter of the set-up is the default one, because an option's file name has no diameter
    diameter = machine.wire.default_diameter_um.model_copy(update={"value": machine.wire_diameter_um})
    wire = machine.wire.model_copy(update={"default_diameter_um": diameter})
    models: dict[str, BaseModel] = {"machine": machine.base, "material": machine.material, "wire": wire}
    parts = {name.partition(".")[0] for name in (*(constant.name for constant in fit.constants), *extra_files)}
    written = {"machine": out}
    written |= {part: out.with_name(f"{out.stem}-{part}.toml") for part in ("material", "wire") if part in parts}
    files.make_writable(out.parent)
    heading = f"# Fitted to {log_name} by edmsim calibrate ({__version__}).\n"
    for part, file in written.items():
        with files.replacing(file) as partial:
            partial.write_text(heading + as_toml(models[part]), encoding="utf-8")
    return written


def _with_sources(fit: Fit, log_name: str) -> dict[str, Any]:
    """Return the changed constants: every fitted one has a new source text, and keeps its range."""
    fitted = {constant.name: constant for constant in fit.constants}
    changed = {}
    for name, constant in ranges.uncertain(fit.machine).items():
        if name in fitted:
            low, high = fitted[name].interval
            remark = f", {fitted[name].remark}" if fitted[name].remark else ""
            before = f"before {fitted[name].before:g}, {constant.source}"
            source = f"fitted to {log_name}: {low:.4g}..{high:.4g} (95 %{remark}); {before}"
            changed[name] = constant.model_copy(update={"source": source})
        elif constant.range is not None and not constant.range[0] <= constant.value <= constant.range[1]:
            changed[name] = constant.model_copy(update={"range": None})  # the cut's override is outside the range
    return changed


def as_toml(model: BaseModel) -> str:
    """Return a machine, wire or material as TOML: first texts, then constants, then tables of constants."""
    document = tomlkit.document()
    document.update({name: _item(value) for name, value in model if value is not None})
    return tomlkit.dumps(document)


def _item(value: Any) -> Any:
    if isinstance(value, BaseModel):
        table = tomlkit.inline_table() if "source" in type(value).model_fields else tomlkit.table()
        table.update({name: _item(item) for name, item in value if item is not None})
        return table
    return list(value) if isinstance(value, tuple) else value


def render(fit: Fit, resolution: str) -> Group:
    """Return the fit for the terminal: constants, undetermined ones, correlations, log and model."""
    numbers = ("before", "fitted", "95 % interval", "range")
    table = screen.ScreenTable("constant", numbers=numbers, box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("")
    for c in fit.constants:
        table.add_row(
            c.name, f"{c.before:g}", f"{c.value:.4g}", _between(c.interval), _between(c.range),
            Text(c.remark, "yellow"),
        )  # fmt: skip
    undetermined = [
        Text(f"the log does not determine {name}: {reason}", "yellow") for name, reason in fit.undetermined.items()
    ]
    warnings = [Text(line, "yellow") for line in (*causes(fit, resolution), *correlated(fit), *refusal(fit))]
    over = f"per degree of freedom over {len(fit.stretches)} stretches; noise alone makes 1 or less"
    misfit = Text(f"misfit {fit.misfit:.2f} {over}")
    return Group(table, *undetermined, misfit, *warnings, _comparison_table(fit))


def _between(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.4g} .. {interval[1]:.4g}"


def causes(fit: Fit, resolution: str) -> list[str]:
    """Return the likely causes of a large misfit, the likeliest first; an empty list if the misfit is small."""
    if fit.misfit <= MUCH:
        return []
    others = " or ".join(f"--resolution {name}" for name in RESOLUTIONS if name != resolution)
    return [
        "The model does not do what the machine did: do not trust the intervals. Likely causes, the likeliest first:",
        f"1. The log was made at another resolution than {resolution}: try {others}.",
        "2. Material, height, wire, tension or generator are not those of the log: give them as for edmsim cut.",
        "3. A constant that was not fitted is wrong: fit more of them with --fit.",
        "4. The log has arcs or corners but no columns x_um and y_um, by which they would be left out.",
        "5. A column has another unit, as percent for counts of 255 pulses, kV, or ms.",
    ]


def correlated(fit: Fit) -> list[str]:
    """Return a line per pair of constants whose errors correlate so much that only a combination is known well."""
    names = [constant.name for constant in fit.constants]
    return [
        f"errors of {names[i]} and {names[j]} are correlated by {fit.correlation[i, j]:+.2f}: "
        "their combination is known better than either"
        for i in range(len(names)) for j in range(i) if abs(fit.correlation[i, j]) > STRONG
    ]  # fmt: skip


def refusal(fit: Fit) -> list[str]:
    """Return why the fitted machine cannot run at the setting of the comparison, or an empty list."""
    try:
        fit.machine.check()
    except InputError as error:
        setting = f"{fit.machine.t_on_us:g} us in {fit.machine.t_period_us:g} us"
        return [f"the fitted machine cannot run at {setting}: {error.reason}"]
    return []


def _comparison_table(fit: Fit) -> screen.ScreenTable:
    """Return the table of the statistics of log and fitted model by stretch."""
    heads = ("feed um/s", "pulse us", "short %", "open %", "V", "A", "delay us")
    table = screen.ScreenTable(*heads[:1], numbers=heads[1:], title="log/fitted model", box=None, pad_edge=False)
    for stretch, simulated in zip(fit.stretches, fit.simulated, strict=True):
        pairs = zip(stretch.mean * _PERCENT, simulated * _PERCENT, strict=True)
        cells = (f"{logged:.3g}/{model:.3g}" for logged, model in pairs)
        table.add_row(f"{stretch.feed_um_s:.1f}", f"{stretch.t_on_us:g}/{stretch.t_period_us:g}", *cells)
    return table


_PERCENT = (100.0, 100.0, 1.0, 1.0, 1.0)


def as_json(fit: Fit, written: Mapping[str, Path]) -> str:
    """Return the fit as JSON; unknown values are null."""
    document = {
        "constants": [c._asdict() for c in fit.constants],
        "undetermined": fit.undetermined,
        "correlation": fit.correlation.tolist(),
        "misfit": fit.misfit,
        "stretches": [
            {
                "first_window": s.first, "feed_um_s": s.feed_um_s, "t_on_us": s.t_on_us, "t_period_us": s.t_period_us,
                "log": _named(s.mean.tolist()), "model": _named(simulated.tolist()),
            }
            for s, simulated in zip(fit.stretches, fit.simulated, strict=True)
        ],
        "files": {part: str(file) for part, file in written.items()},
    }  # fmt: skip
    return json.dumps(document, indent=2, allow_nan=False)


def _named(values: list[float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in zip(STATISTICS, values, strict=True)}
