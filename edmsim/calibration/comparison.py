"""Comparison of a machine with a log: statistics of simulated cuts minus logged ones, in units of their noise."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from edmsim import __version__, runs
from edmsim.calibration.log import STATISTICS, STRETCH_WINDOWS, Stretch, statistics
from edmsim.closed_loop.straight import Traverse, begin
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine, constants_digest
from edmsim.machine.setting import WINDOW_PULSES, short_current_A
from edmsim.plant.window import PlantError

SHRINKAGE = 0.2
"""Shrinkage of the measured correlations to 0 (ours, because some twenty cuts determine them poorly)."""
READING = (1e-3, 1e-3, 2e-3, 2e-3, 5e-3)
"""Least standard deviations of a stretch's statistics, the last three relative (ours: of a counter and a meter)."""
NOISE_CUTS = 24
"""Least number of cuts, over all stretches, that measure the noise (ours: they give variances to a third)."""
LEAST_REPLICATES = 4
USUAL_ROUNDS = 7
"""Usual number of machines around which a fit simulates all stretches (ours: 5 to 9 for 1 to 8, 3 constants)."""


class CalibrationProgress(NamedTuple):
    """Progress of a calibration."""

    cuts: int  # finished ones
    usual: int  # rough number of cuts of a fit with these numbers of constants and stretches
    misfit: float  # last misfit per degree of freedom; NaN before the first


class StretchComparison:
    """Stretches of a log, and their simulation, which uses the same random draws for every machine."""

    def __init__(
        self, machine: Machine, picked: list[Stretch], seed: int, resolution: str, table: runs.RunTable,
        watch: Callable[[CalibrationProgress], None] | None, constants: int,
    ) -> None:
        self.machine, self.picked = machine, picked
        self.misfit = math.nan
        self._seed, self._resolution, self._table, self._watch = seed, resolution, table, watch
        self._known = np.array([np.isfinite(stretch.mean) for stretch in picked])
        self.size = int(self._known.sum())
        self._repeats = max(LEAST_REPLICATES, math.ceil(NOISE_CUTS / len(picked)))
        self._usual = len(picked) * (2 * self._repeats + USUAL_ROUNDS * (2 * constants + 1))
        self.weight_by_noise_of(machine)

    def weight_by_noise_of(self, machine: Machine) -> None:
        """Weight the statistics by the noise of this machine's cuts."""
        # The noise depends on the cut's shares of open and short pulses. A log made with a gap controller does not
        # show it, because the controller keeps the counts steadier than a cut at a fixed feed would.
        # The log's batches show the noise of each stretch without its slow part, which comes from walls that the wire
        # passes for one diameter of travel. The ratio of the whole variance to that of batches, and correlations, are
        # measured with cuts of the same stretches with other seeds. The simulated cut doubles the variance.
        repeats = self._repeats
        first = self._seed + len(self.picked)
        jobs = [(machine, k, first + r * len(self.picked) + k)
                for r in range(repeats) for k in range(len(self.picked))]  # fmt: skip
        cuts = np.nan_to_num(self._run(jobs))
        apart = cuts - cuts.mean(axis=0)
        between = np.maximum((apart**2).sum(axis=0) / (repeats - 1), 1e-24)  # (stretches, 5)
        within = np.array([_variance_of_mean(stretch.batches) for stretch in self.picked])
        more = np.maximum(np.mean(between / np.maximum(within, between / 100), axis=0), 1.0)
        scaled = (apart / np.sqrt(between)).reshape(-1, len(STATISTICS))
        correlation = (1 - SHRINKAGE) * scaled.T @ scaled / ((repeats - 1) * len(self.picked))
        np.fill_diagonal(correlation, 1.0)
        root = np.linalg.cholesky(correlation)
        # Cholesky factors of covariances, (5, 5) per stretch: of simulated minus logged, and of simulated
        self._scales, self._scales_alone = list[Floats](), list[Floats]()
        for stretch, variance in zip(self.picked, within, strict=True):
            reading = np.array(READING) * np.where([False, False, True, True, True], np.nan_to_num(stretch.mean), 1.0)
            self._scales.append(np.sqrt(2 * more * variance + reading**2)[:, None] * root)
            self._scales_alone.append(np.sqrt(more * variance)[:, None] * root)

    @property
    def simulation_share(self) -> float:
        """Part of the variance of all residuals, 1 each, that is due to the noise of the simulated cuts."""
        pairs = zip(self._known, self._scales, self._scales_alone, strict=True)
        alone = [np.linalg.solve(both[np.ix_(k, k)], one[np.ix_(k, k)]) for k, both, one in pairs]
        return float(sum((part**2).sum() for part in alone))

    @property
    def noise(self) -> Floats:
        """Standard deviation of simulated minus logged statistics, (stretches, 5)."""
        return np.array([np.sqrt((scale**2).sum(axis=1)) for scale in self._scales])

    def statistics(self, machines: Sequence[Machine]) -> Floats:
        """Simulate every stretch with every machine; return (machines, stretches, 5)."""
        return self._run([(m, k, self._seed + k) for m in machines for k in range(len(self.picked))])

    def _run(self, jobs: Sequence[tuple[Machine, int, int]]) -> Floats:
        def count(*_: int) -> None:
            if self._watch is not None:
                self._watch(CalibrationProgress(len(self._table.rows), self._usual, self.misfit))

        rows = runs.perform(self._simulate, jobs, count, table=self._table, ids=[self._id(*job) for job in jobs])
        return np.array([row["statistics"] for row in rows]).reshape(-1, len(self.picked), len(STATISTICS))

    def _id(self, machine: Machine, number: int, seed: int) -> str:
        stretch = self.picked[number]
        setting = stretch.feed_um_s, stretch.t_on_us, stretch.t_period_us, stretch.travelled_um
        return runs.identity({
            "edmsim": __version__, "machine": constants_digest(machine), "stretch": setting, "seed": seed,
            "resolution": self._resolution,
        })  # fmt: skip

    def _simulate(self, job: tuple[Machine, int, int]) -> dict[str, Any]:
        machine, number, seed = job
        stretch = self.picked[number]
        batches = simulate(machine, stretch, STRETCH_WINDOWS, seed, self._resolution)
        mean = Stretch(0, stretch.feed_um_s, stretch.t_on_us, stretch.t_period_us, batches).mean
        return {"statistics": mean.tolist()}

    def residuals(self, simulated: Floats) -> Floats:
        """Return simulated (stretches, 5) minus logged statistics, decorrelated, in units of their noise, (size,)."""
        rows = []
        for number, stretch in enumerate(self.picked):
            known = self._known[number]
            # a statistic that is NaN in the simulation (no ignition at all) counts as 0
            apart = np.where(np.isfinite(simulated[number]), simulated[number], 0.0) - stretch.mean
            rows.append(np.linalg.solve(self._scales[number][np.ix_(known, known)], apart[known]))
        return np.concatenate(rows)


def _variance_of_mean(batches: Floats) -> Floats:
    """Return the variance of each statistic's mean over independent batches, (5,)."""
    known = np.isfinite(batches)
    count = np.maximum(known.sum(axis=0), 2)
    mean = np.where(known, batches, 0.0).sum(axis=0) / count
    return np.asarray((np.where(known, batches - mean, 0.0) ** 2).sum(axis=0) / (count - 1) / count)


SETTLED_DIAMETERS = 1.3
"""Travel, in wire diameters, after which walls and gap nearly correspond to the present feed (ours: shares of short
circuits rise most over the first 300 um of a cut with the 250 um wire)."""
WHOLLY_SETTLED_DIAMETERS = 5.0
"""Most travel, in wire diameters, that is simulated before a stretch (ours: with a 200 um wire the share of short
circuits rises from 13.5 % after 0.3 mm to 14.4 % after 1 mm, as in a log of 12 mm; each known to 0.2 %)."""


def settle_um(machine: Machine) -> float:
    """Return the settling travel after a change of feed or setting."""
    return SETTLED_DIAMETERS * machine.wire_diameter_um


def simulate(machine: Machine, stretch: Stretch, windows: int, seed: int, resolution: str) -> Floats:
    """Cut straight at a stretch's feed and setting; return `log.STATISTICS` of its batches, (batches, 5)."""
    # Before the measurement the cut travels as far as the log did at this feed and setting, but at most until it is
    # wholly settled. If the wire breaks or is driven into the metal, missing windows count as short circuits, because
    # these statistics differ most from those of a machine that cuts.
    set_up = machine.model_copy(update={"t_on_us": stretch.t_on_us, "t_period_us": stretch.t_period_us})
    rows: list[tuple[float, ...]] = []
    try:
        traverse = Traverse(begin(set_up, seed, resolution=resolution), stretch.feed_um_s)
        wholly_um = WHOLLY_SETTLED_DIAMETERS * machine.wire_diameter_um
        travel_um = min(max(stretch.travelled_um, settle_um(machine)), wholly_um)
        w = traverse.run(travel_um / stretch.feed_um_s)[-1]
        while not w.broken and len(rows) < windows:
            w = traverse.window()
            if not w.broken:
                rows.append((w.short, w.open, w.mean_voltage_V, w.mean_current_A, w.mean_delay_us))
    except PlantError:
        pass
    short_A = short_current_A(set_up) * stretch.t_on_us / stretch.t_period_us
    rows += [(WINDOW_PULSES, 0, 0.0, short_A, 0.0)] * (windows - len(rows))
    return statistics(*np.array(rows, float).T)
