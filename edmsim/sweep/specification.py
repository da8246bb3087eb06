"""The specification of a sweep: programs or environments, settings, grid, Sobol sample, seeds, machines; its runs."""

import itertools
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, Field, ModelWrapValidatorHandler, ValidationError, model_validator

from edmsim import __version__, files, numeric, runs, user_code
from edmsim.controllers import from_text
from edmsim.envs import registry
from edmsim.errors import InputError, located, one_of, refused_entry, refuses_wrong_types
from edmsim.evaluation.episode import HELD_BACK
from edmsim.job import plan
from edmsim.job.options import CutSettings
from edmsim.machine import options, overrides, ranges
from edmsim.machine.machine import Machine
from edmsim.machine.technology import Technology
from edmsim.program.passes import grouped

_NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_RANGE = re.compile(rf"({_NUMBER}):({_NUMBER}):({_NUMBER})")
MOST_OF_RANGE = 100_000
"""Limit of the values of a range (ours: a step mistyped by some powers of ten raises an error)."""


def values_of(text: Any, name: str) -> list[Any]:
    """Return the values of a setting from a list, or from a text with commas and ranges ``FIRST:LAST:STEP``."""
    found: list[Any]
    if isinstance(text, list | tuple | np.ndarray):
        found = [numeric.plain(value) for value in (text.ravel() if isinstance(text, np.ndarray) else text)]
    elif isinstance(text, str):
        found = [value for piece in user_code.listed(text) for value in _values_of_piece(piece, name)]
    else:
        found = [text]
    if not found:
        raise InputError(f"{name} has no value to try: give some, as [5, 10, 20] or '5:20:5'")
    return found


def _values_of_piece(piece: str, name: str) -> list[Any]:
    spaced = _RANGE.fullmatch(piece)
    if spaced is None:
        return [number_or_text(piece)]
    first, last, step = (float(part) for part in spaced.groups())
    count = (last - first) / step if step else math.nan
    if not 0 <= count < MOST_OF_RANGE:
        raise InputError(f"{name} cannot go from {first:g} to {last:g} in steps of {step:g}: give FIRST:LAST:STEP")
    whole = all(float(part).is_integer() for part in (first, step))
    # multiples of the step, because a sum of steps may miss the last value; 12 digits hide rounding errors
    spread = [float(f"{first + k * step:.12g}") for k in range(math.floor(count + 1e-9) + 1)]
    return [int(value) for value in spread] if whole else spread


def number_or_text(text: str) -> Any:
    """Return a text's value: an int, a float, or a bool for ``true`` and ``false``; else the text itself."""
    if text in ("true", "false"):
        return text == "true"
    if not re.fullmatch(_NUMBER, text):
        return text
    value = float(text)
    return int(text) if re.fullmatch(r"[-+]?[0-9]+", text) and math.isfinite(value) else value


def flattened(table: Mapping[str, Any]) -> dict[str, Any]:
    """Name constants as ``section.key``, whether their key was written in quotes or became a table of TOML."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{key}": inner for key, inner in flattened(value).items()}
        else:
            flat[name] = value
    return flat


class Bound(NamedTuple):
    """Range in which a value is searched or sampled, evenly in the value or in its logarithm."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    @classmethod
    def of(cls, value: Any) -> Self | None:
        """Return the bound ``(low, high)`` or ``(low, high, scale)``; None for anything else."""
        if not isinstance(value, tuple | list) or len(value) not in (2, 3):
            return None
        low, high, scale = numeric.real(value[0]), numeric.real(value[1]), (*value, "linear")[2]
        if low is None or high is None or not -1e300 < low < high < 1e300:
            return None
        return cls(float(low), float(high), scale) if scale == "linear" or (scale == "log" and low > 0) else None

    def at(self, share: float) -> float:
        """Return the value at a share, 0 to 1, of the range."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + (self.high - self.low) * share)


MOST_SEEDS = 10_000_000
"""Most seeds of a sweep as a number (ours: their list takes some 400 MB; no sweep has as many cuts)."""
MOST_POINTS = 1 << 24  # most points of a Sobol sample (ours: with ten numbers each, a gigabyte)
Recorded = Literal["report", "windows", "all"]
"""Files saved of each cut: ``report.json``, ``windows.parquet``, or all that ``edmsim cut`` writes."""


class SobolSample(BaseModel, extra="forbid", frozen=True):
    """Scrambled Sobol sequence, which fills a space evenly (`scipy.stats.qmc.Sobol`)."""

    # number of points, a power of 2; other numbers do not cover the space evenly
    samples: Annotated[numeric.WholeNumber, Field(ge=1, le=MOST_POINTS)]
    seed: Annotated[numeric.WholeNumber, Field(ge=0)] = 0  # seed of the scrambling
    # for each setting or constant ``[low, high]``, ``[low, high, "log"]`` to sample its logarithm evenly, or
    # ``"range"`` for the published range of a constant
    ranges: Annotated[dict[str, Any], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.samples & (self.samples - 1):
            below = 2 ** (self.samples.bit_length() - 1)
            raise InputError(f"a Sobol sample has a power of 2 of points: {below} or {2 * below}, not {self.samples}")
        for name, value in self.ranges.items():
            if value != "range" and Bound.of(value) is None:
                raise InputError(
                    f"{name} of a Sobol sample is [low, high], [low, high, 'log'] above zero, or 'range', "
                    f"not {value!r}"
                )
        return self


class Specification(BaseModel, extra="forbid", frozen=True):
    """Description of a sweep; it determines every run.

    Raises
    ------
    InputError
        If the specification is invalid.
    """

    # program, environment: either part programs or ids of environments (``FILE.py:ID`` for your own)
    program: list[options.TextOrPath] = []
    environment: list[str] = []
    # a single number is a count: seeds from 0 on for programs, held-back ones for environments, because training may
    # have used others
    seeds: list[Annotated[int, Field(ge=0)]] = [0]
    # number of machines to draw within the ranges of their constants (`Machine.sample`); 0 uses the files' machine.
    # Environments draw their own.
    machine_samples: Annotated[int, Field(ge=0)] = 0
    sample_only: list[str] | None = None  # sections and constants to draw; by default all
    recordings: list[Recorded] = []
    # options of a cut, or ``controller`` and arguments of the environment, for every run; constants by
    # ``section.key``, entries of an argument that is a mapping by ``weights.short``
    settings: dict[str, Any] = {}
    grid: dict[str, list[Any]] = {}  # lists of values of further settings; every combination is run
    sobol: SobolSample | None = None  # points to run with every combination of the grid

    @model_validator(mode="wrap")
    @classmethod
    def _refuse_in_one_line(cls, value: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(value)
        except ValidationError as error:
            first, (name, reason) = error.errors()[0], refused_entry(error)
            if first["type"] == "extra_forbidden":
                keys = cls.model_fields
                known = one_of(name, keys, [*keys, "with options under [settings] and [grid]"])
                raise InputError(f"a sweep has no '{name}'; it has {known}") from None
            if first["type"] == "missing":
                raise InputError(f"{name} is missing") from None
            raise InputError(f"{name} cannot be {first['input']!r}: {reason}") from None

    @model_validator(mode="before")
    @classmethod
    def _short_forms(cls, value: Any) -> Any:
        """Expand a text to a list of one, a number of seeds to seeds, and ranges to their values."""
        if not isinstance(value, Mapping):
            return value
        full = dict(value)
        for name in ("program", "environment", "recordings"):
            if isinstance(one := options.as_text(full.get(name)), str):
                full[name] = [one]
        if (count := numeric.whole(full.get("seeds"))) is not None:
            if count > MOST_SEEDS:
                reason = f"{count} seeds are too many: at most {MOST_SEEDS}; several sweeps can fill one folder"
                raise InputError(reason)
            first = HELD_BACK if full.get("environment") else 0
            full["seeds"] = list(range(first, first + count))
        for name in ("settings", "grid"):
            if isinstance(full.get(name), Mapping):
                full[name] = flattened(full[name])
        if isinstance(full.get("grid"), dict):
            full["grid"] = {name: values_of(values, name) for name, values in full["grid"].items()}
        sobol = full.get("sobol")
        if isinstance(sobol, Mapping) and isinstance(sobol.get("ranges"), Mapping):
            ends_of = flattened(sobol["ranges"]).items()
            of_points = {name: ends if isinstance(ends, str) else values_of(ends, name) for name, ends in ends_of}
            full["sobol"] = {**sobol, "ranges": of_points}
        return full

    @model_validator(mode="after")
    def _check(self) -> Self:
        if bool(self.program) == bool(self.environment):
            raise InputError("a sweep is of programs or of environments: give either program or environment")
        lists: dict[str, list[Any]] = {
            "program": self.program, "environment": self.environment, "seeds": self.seeds, **self.grid,
        }  # fmt: skip
        for name, values in lists.items():
            if (twice := _repeated(values)) is not None:
                raise InputError(f"{name} has {twice!r} twice: a sweep makes every run once")
        if not self.seeds:
            raise InputError("a sweep without seeds has no run: give a number of them, or a list")
        for file in self.program:
            if not os.path.isfile(file):  # False also if the name is too long or has a null byte
                raise InputError("there is no such program", file)
        sampled = () if self.sobol is None else self.sobol.ranges
        names = [_option(name, self) for name in (*self.settings, *self.grid, *sampled)]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"{name} is given twice: in one of settings, grid and sobol")
            if name == "seed":
                raise InputError("seed is not a setting of a sweep: give seeds, a number of them or a list")
        for name, value in self.settings.items():
            if isinstance(value, list) and not _takes_several(_option(name, self), self):
                raise InputError(f"{name} is one value under [settings], not {value}: several to try go under [grid]")
        if self.environment and (self.machine_samples or self.sample_only):
            raise InputError("an environment draws its machines itself (randomise): machine_samples is for programs")
        if self.sample_only is not None and not self.machine_samples:
            raise InputError("sample_only says what is drawn of machines: give their number as machine_samples")
        if self.environment and self.recordings:
            raise InputError("an environment leaves no recordings: recordings is for programs")
        return self

    @property
    def tasks(self) -> list[str]:
        """Programs or environments."""
        return self.program or self.environment

    @property
    def runs(self) -> int:
        """Number of runs."""
        combinations = math.prod(len(values) for values in self.grid.values())
        points = 1 if self.sobol is None else self.sobol.samples
        return len(self.tasks) * combinations * points * len(self.seeds) * max(self.machine_samples, 1)


@refuses_wrong_types
def read_specification(file: str | Path) -> Specification:
    """Read a specification from a TOML file; its paths are relative to the working directory.

    Raises
    ------
    InputError
        If the file cannot be read, is not TOML, or does not describe a sweep.
    """
    data = files.read_toml(file)
    try:
        with located(file):
            return Specification.model_validate(data)
    except RecursionError:
        raise InputError("its tables are nested too deep", file) from None


_FLAGS = {"seeds": "--seeds", "machine_samples": "--machine-samples", "recordings": "--record"}


def specification_of(what: str, words: Sequence[str], **entries: Any) -> Specification:
    """Return the specification from a file, or from a program or an environment and the words after it."""
    chosen = {name: value for name, value in entries.items() if value not in (None, [])}
    if what.endswith(".toml"):
        if superfluous := [*(_FLAGS[name] for name in chosen), *words]:
            raise InputError(f"a specification has all settings: leave out {' '.join(superfluous)}")
        return read_specification(what)
    is_program = user_code.named(what) is None and (os.path.isfile(what) or Path(what).suffix)
    kind = "program" if is_program else "environment"
    return Specification.model_validate({kind: what, "grid": _grid_of(words), **chosen})


def _grid_of(words: Sequence[str]) -> dict[str, str]:
    """Parse words such as ``--height 5,10 --t-on=10:40:5``."""
    found: dict[str, str] = {}
    left = list(words)
    while left:
        name, joined, value = left.pop(0).partition("=")
        if not name.startswith("--"):
            raise InputError(f"'{name}' belongs to no option; values are given as --height 5,10,20")
        if not joined:
            if not left:
                raise InputError(f"{name} has no values: give some, as {name} 5,10,20")
            value = left.pop(0)
        key = name.removeprefix("--")
        found[key] = f"{found[key]},{value}" if key in found else value
    return found


def _repeated(values: list[Any]) -> Any:
    """Return the first value that a list has twice, or None."""
    known = set()
    for value in values:
        key = value if isinstance(value, int | float) else repr(value)
        if key in known:
            return value
        known.add(key)
    return None


class SweepRun(NamedTuple):
    """One run of a sweep, as plain data that can be sent to any computer."""

    id: str  # digest of all fields below except recordings and paths; files count by their content
    task: str  # program or environment, as the user wrote it
    is_cut: bool  # whether it is a program
    # options of the cut, constants among them; or the environment's arguments, controller and resolution
    settings: Mapping[str, Any]
    seed: int
    machine_sample: int | None  # number of the drawn machine; None for the files' machine
    sample_only: tuple[str, ...] | None  # sections and constants that are drawn
    recordings: tuple[str, ...]
    files: Mapping[str, str]  # digests of the files the run reads, by their path


def runs_of(specification: Specification) -> Iterator[SweepRun]:
    """Yield the runs of a `Specification`, without holding all of them in memory."""
    # drawn machines and seeds vary fastest, so runs that are compared are made at about the same time
    spec = specification
    samples = range(spec.machine_samples) if spec.machine_samples else [None]
    for task, bounds in combinations(spec):
        settings = checked(task, bounds, bool(spec.program))
        for sample, seed in itertools.product(samples, spec.seeds):
            yield _run(task, settings, seed, sample, spec)


def combinations(spec: Specification) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every task with every combination of the specified settings, by their full names."""
    names = [_option(name, spec) for name in spec.grid]
    fixed = {_option(name, spec): value for name, value in spec.settings.items()}
    for combination in itertools.product(*spec.grid.values()):
        chosen = {**fixed, **dict(zip(names, combination, strict=True))}
        points = [sobol_points(spec, task, chosen) for task in spec.tasks]
        for of_tasks in zip(*points, strict=True):
            for task, point in zip(spec.tasks, of_tasks, strict=True):
                yield task, {**chosen, **point}


def sobol_points(spec: Specification, task: str, chosen: Mapping[str, Any]) -> list[dict[str, float]]:
    """Return the points of a sample for a task, with values by the names of its ranges; without a sample ``[{}]``."""
    if (sobol := spec.sobol) is None:
        return [{}]
    from scipy.stats import qmc

    shares = qmc.Sobol(len(sobol.ranges), rng=np.random.default_rng(sobol.seed)).random(sobol.samples)
    columns = {}
    for (name, ends), share in zip(sobol.ranges.items(), shares.T, strict=True):
        if (bound := Bound.of(ends)) is None:
            published = _published(name, task, chosen)
            columns[name] = [ranges.value_at(published, float(s)) for s in share]
        else:
            columns[_option(name, spec)] = [bound.at(s) for s in share]
    return [dict(zip(columns, point, strict=True)) for point in zip(*columns.values(), strict=True)]


_DECIDING = (
    "machine", "material", "wire", "passes", "technology", "ignore", "layers", "unit", "offsets", "dialect",
    "conditions", "upper_layer",
)  # fmt: skip
"""Options that determine the machine of a cut: that of `machine`, or with passes that of a technology."""


def _published(name: str, task: str, chosen: Mapping[str, Any]) -> tuple[float, float]:
    """Return the published range of a constant, for the machine of the cut."""
    settings = CutSettings.model_validate({option: chosen[option] for option in _DECIDING if option in chosen})
    in_passes = settings.passes is not None
    if not in_passes and settings.conditions is None and os.path.isfile(task):
        in_passes = any(len(edge) > 1 for edge in grouped(plan.read_program(task, settings).outlines))
    parts: CutSettings | Technology = plan.technology_of(settings) if in_passes else settings
    known = Machine.load(parts.machine, material=settings.material, wire=parts.wire).uncertain()
    bounds = known[name].range if name in known else None
    if bounds is None:
        raise InputError(f"'{name}' is not a constant with a published range; give one, as [low, high]")
    return bounds


def _option(name: str, spec: Specification) -> str:
    """Return an option's full name; ``section.key`` is a constant."""
    if "." in name:
        return name
    spelt = name.replace("-", "_")
    if spec.environment:
        return spelt
    fields = {option: field for option, field in CutSettings.model_fields.items() if option != "constants"}
    flags = {option: options.flag(option, field).removeprefix("--") for option, field in fields.items()}
    found = [o for o, flag in flags.items() if spelt in (o, options.bare_name(o), flag.replace("-", "_"))]
    if not found:
        listed_by = ["those of edmsim cut --help", "and constants, as gap.critical_um"]
        known = one_of(name.replace("_", "-"), list(flags.values()), listed_by)
        raise InputError(f"a cut has no option '{name}'; there are {known}")
    return found[0]


def _takes_several(option: str, spec: Specification) -> bool:
    """Return whether a setting can be a list, such as the heights of a cut or the ranges of an environment."""
    if spec.environment:
        return option != "controller"
    return option in CutSettings.model_fields and "[" in options.kind_of(CutSettings.model_fields[option].annotation)


def checked(task: str, combination: Mapping[str, Any], is_cut: bool) -> dict[str, Any]:
    """Return all settings of a run, with defaults for those left out."""
    if is_cut:
        constants = {name: value for name, value in combination.items() if "." in name}
        overrides.check_names(constants)
        others = {name: value for name, value in combination.items() if "." not in name}
        settings = CutSettings.model_validate({**others, "constants": constants})
        from_text(str(settings.controller))
        return settings.model_dump(mode="json", exclude={"seed"})
    return _arguments(task, combination)


MAPPINGS = "weights", "sensors", "machine"
"""Arguments of an environment that are mappings; a setting ``weights.short`` is an entry of one."""


def arguments_of(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of an environment; settings such as ``weights.short`` are combined to mappings."""
    found = {name: value for name, value in settings.items() if "." not in name}
    mappings: dict[str, Any] = {}
    for name in (name for name in settings if name not in found):
        mapping, _, entry = name.partition(".")
        if mapping not in MAPPINGS:
            raise InputError(f"an environment draws its constants itself (randomise): {name} cannot be set")
        if mapping in found:
            raise InputError(f"{mapping} and {name} are both given: give one of them")
        mappings.setdefault(mapping, {})[entry] = settings[name]
    return {**found, **mappings}


def _arguments(env_id: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return an environment's settings, including controller and resolution; raise `InputError` if invalid."""
    name, arguments = registry.resolve(env_id), arguments_of(settings)
    arguments.pop("controller", None)
    try:
        family = registry.make_family(name, **arguments)
    except TypeError as error:
        raise InputError(f"{env_id} cannot take these arguments: {error}") from None
    full = {"controller": "counts", "resolution": str(family.resolution), **settings}
    from_text(str(full["controller"]))
    return full


def _run(task: str, settings: dict[str, Any], seed: int, sample: int | None, spec: Specification) -> SweepRun:
    digests = runs.digests_of((task, *settings.values()))
    only = None if spec.sample_only is None or sample is None else tuple(sorted(spec.sample_only))
    content = {
        "edmsim": __version__, "task": Path(task).name if spec.program else task, "files": sorted(digests.values()),
        "settings": settings, "seed": seed, "machine_sample": sample, "sample_only": only,
    }  # fmt: skip
    name = runs.identity(content)
    return SweepRun(name, task, bool(spec.program), settings, seed, sample, only, tuple(spec.recordings), digests)
