"""The table of runs that a specification stands for; a run's id is a digest of all that decides its result."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edmsim import __version__
from edmsim.controllers import from_text
from edmsim.errors import InputError, one_of
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.options import USUAL_MACHINE, bare_name
from edmsim.machine.overrides import check_names
from edmsim.machine.ranges import value_at
from edmsim.runs import digests_of, identity
from edmsim.sweep.specification import SobolSample, Specification


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep: plain data that any computer can be sent."""

    id: str  # digest of all that follows but recordings and paths: program and files by their text
    task: str  # program or environment, as it was given
    is_cut: bool  # whether it is a program
    # options of the cut, constants among them; or the environment's arguments, controller and resolution
    settings: Mapping[str, Any]
    seed: int
    machine_sample: int | None  # which draw of a machine; None for the machine as it is
    sample_only: tuple[str, ...] | None  # what is drawn of it
    recordings: tuple[str, ...]
    files: Mapping[str, str]  # digests of the files the run reads, by their path


def runs_of(specification: Specification) -> Iterator[SweepRun]:
    """Yield the runs of a `Specification`, without holding all of them in memory."""
    # machines drawn and seeds vary fastest, so that what is compared with each other is cut at about the same time
    spec = specification
    for task, bounds in combinations(spec):
        settings = checked(task, bounds, bool(spec.program))
        for sample, seed in itertools.product(_samples(spec), spec.seeds):
            yield _run(task, settings, seed, sample, spec)


def combinations(spec: Specification) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every task with every combination of the specified settings, by their full names."""
    names = [_option(name, spec) for name in spec.grid]
    fixed = {_option(name, spec): value for name, value in spec.settings.items()}
    for combination in itertools.product(*spec.grid.values()):
        chosen = {**fixed, **dict(zip(names, combination, strict=True))}
        points = [{}] if spec.sobol is None else sobol_points(spec.sobol, spec, chosen)
        for point, task in itertools.product(points, spec.tasks):
            yield task, {**chosen, **point}


def sobol_points(sobol: SobolSample, spec: Specification, chosen: Mapping[str, Any]) -> list[dict[str, float]]:
    """Return the points of a sample, each with a value for every name in its ranges."""
    from scipy.stats import qmc

    shares = qmc.Sobol(len(sobol.ranges), rng=np.random.default_rng(sobol.seed)).random(sobol.samples)
    columns = {}
    for (name, bounds), share in zip(sobol.ranges.items(), shares.T, strict=True):
        if bounds == "range":
            low, high = _published(name, chosen)
            columns[name] = [value_at((low, high), float(s)) for s in share]
        elif len(bounds) == 3:
            columns[_option(name, spec)] = [float(bounds[0] * (bounds[1] / bounds[0]) ** s) for s in share]
        else:
            columns[_option(name, spec)] = [float(bounds[0] + (bounds[1] - bounds[0]) * s) for s in share]
    return [dict(zip(columns, point, strict=True)) for point in zip(*columns.values(), strict=True)]


def _published(name: str, chosen: Mapping[str, Any]) -> tuple[float, float]:
    """Return the range of a constant of the machine that is cut on."""
    parts = {part: chosen[part] for part in ("material", "wire") if part in chosen}
    known = Machine.load(chosen.get("machine", USUAL_MACHINE), **parts).uncertain()
    bounds = known[name].range if name in known else None
    if bounds is None:
        raise InputError(f"'{name}' is not a constant with a published range; give one, as [low, high]")
    return bounds


def _samples(spec: Specification) -> list[int | None]:
    return list(range(spec.machine_samples)) if spec.machine_samples else [None]


def _option(name: str, spec: Specification) -> str:
    """Return an option's full name; ``section.key`` is a constant."""
    plain = name.replace("-", "_")
    if "." in name or spec.environment:
        return name if "." in name else plain
    found = [option for option in CutSettings.model_fields if plain in (option, bare_name(option))]
    if not found or found[0] == "constants":
        raise InputError(f"a cut has no option '{name}'; there are: {one_of(name, CutSettings.model_fields)}")
    return found[0]


def checked(task: str, combination: Mapping[str, Any], is_cut: bool) -> dict[str, Any]:
    """Return all settings of a run, those left out at their defaults."""
    options = {name: value for name, value in combination.items() if "." not in name}
    constants = {name: value for name, value in combination.items() if "." in name}
    if is_cut:
        check_names(constants)
        settings = CutSettings.model_validate({**options, "constants": constants})
        from_text(str(settings.controller))
        return settings.model_dump(mode="json", exclude={"seed"})
    if constants:
        named = ", ".join(constants)
        raise InputError(f"an environment draws its constants itself (randomise): {named} cannot be set")
    return _arguments(task, options)


def _arguments(env_id: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return an environment's arguments, with the controller and the resolution among them."""
    from edmsim.envs.registry import make_family, resolve

    name = resolve(env_id)
    try:
        family = make_family(name, **{key: value for key, value in options.items() if key != "controller"})
    except TypeError as error:
        raise InputError(f"{env_id} cannot take these arguments: {error}") from None
    full = {"controller": "counts", "resolution": str(family.resolution), **options}
    from_text(str(full["controller"]))
    return full


def _run(task: str, settings: dict[str, Any], seed: int, sample: int | None, spec: Specification) -> SweepRun:
    files = digests_of((task, *settings.values()))
    only = None if spec.sample_only is None or sample is None else tuple(sorted(spec.sample_only))
    content = {
        "edmsim": __version__, "task": Path(task).name if spec.program else task, "files": sorted(files.values()),
        "settings": settings, "seed": seed, "machine_sample": sample, "sample_only": only,
    }  # fmt: skip
    name = identity(content)
    return SweepRun(name, task, bool(spec.program), settings, seed, sample, only, tuple(spec.recordings), files)
