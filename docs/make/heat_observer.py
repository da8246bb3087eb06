"""How well a recurrent network estimates the wire's temperature in MaxRate: `python docs/make/heat_observer.py`.

Writes two tables of tasks/max-rate.md in 20 minutes of processor time. `heat-flux` cuts machines drawn with training
seeds, each with a random share of the critical flux. A recurrent network learns the wire's true temperature from the
machine's measurements, window by window. Then a law that holds the network's estimate and `heat-flux` cut other
machines. Needs the extra `rl`.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from sections import table, write_sections

from edmsim.controllers import FeedController
from edmsim.controllers.feed.law import Gauge, OpenShare, ServoLaw
from edmsim.controllers.feed.laws import HEAT, HeatFluxController
from edmsim.controllers.feed.periods import FluxGauge, HeatFluxHold, HeatGauge
from edmsim.controllers.protocols import WindowObservation
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode, Result
from edmsim.machine.machine import Machine

ENV_ID = "edmsim/MaxRate-v1"
LEARNED, TESTED, CUT = range(10_000, 10_640), range(20_000, 20_160), range(2_000, 2_096)
"""Seeds of the machines for training the network, for testing it, and for comparing the laws."""
HOLDS = 0.12, 0.36
"""Range of the shares of the critical flux in cuts for the network."""
NETWORK_HOLDS = -0.7, -0.5, -0.3
"""Set-points of the law with the network: superheats relative to the one at which the wire boils dry."""
BEGIN_S = 2.0
"""Ignored begin of each wire, because it reaches its period slowly."""
COLDEST, DRY = -2.5, 1.2
"""Superheats are clamped below at the first, and ignored above the second, because the wire has boiled dry."""
CELLS, EPOCHS, MACHINES_A_STEP, RATE = 64, 16, 16, 3e-3
Floats = NDArray[np.float64]


def features(window: WindowObservation, gauge: FluxGauge, age_s: float, machine: Machine) -> list[float]:
    """Return the inputs of the network: a window, the fluxes that `heat-flux` computes, and the set-up."""
    flux = gauge.flux
    visible = [window.short, window.open, window.mean_voltage_V, window.mean_current_A, window.mean_delay_us]
    setup = [machine.height_mm, machine.tension, machine.flushing_lower_Pa, machine.flushing_upper_Pa]
    values = [*visible, window.duration_s, *window.fifths, *flux, flux.max(), min(age_s, BEGIN_S + 1.0), *setup]
    return [0.0 if not np.isfinite(value) else float(value) for value in values]


class Recorded(NamedTuple):
    """Measurements and hidden state of a cut's windows.

    Attributes
    ----------
    visible : (n, features)
    superheat, flux : (n,)
        The true superheat, and the greatest flux that `heat-flux` computes.
    counts : (n,) bool
        Which windows count.
    hidden : (k,)
        Constants of the machine.
    """

    visible: Floats
    superheat: Floats
    flux: Floats
    counts: NDArray[np.bool_]
    hidden: Floats

    def with_hidden(self) -> "Recorded":
        """Return a copy whose `visible` includes the constants."""
        return self._replace(visible=np.hstack([self.visible, np.tile(self.hidden, (len(self.visible), 1))]))


def record(seed: int) -> Recorded:
    """Cut a machine with `heat-flux` at a random share."""
    hold = np.random.default_rng(seed).uniform(*HOLDS)
    task, law = Task(ENV_ID), HeatFluxController(hold_share=float(hold))
    episode, rows, age_s, lost = Episode(task, law, seed, "heat-flux"), [], 0.0, 0
    machine, meter, gauge = task.scenario.machine, HeatGauge(), law.gauge
    meter.set_up(machine, task.scenario.legs_um[0], 0.0)
    for result in episode.windows():
        window, truth = result.observation, result.truth
        age_s = age_s + window.duration_s if task.wires_lost == lost else 0.0
        lost = task.wires_lost
        meter.see(truth)
        rows.append((*features(window, gauge, age_s, machine), meter.near(window), gauge.flux.max(), age_s))
    found = np.array(rows)
    superheat = np.maximum(found[:, -3], COLDEST)
    counts, hidden = (found[:, -1] > BEGIN_S) & (superheat < DRY), machine.uncertain().values()
    return Recorded(found[:, :-3], superheat, found[:, -2], counts, np.array([constant.value for constant in hidden]))


class Network(torch.nn.Module):
    """A GRU whose output is a superheat, with the normalisation of its inputs."""

    def __init__(self, mean: Floats, scale: Floats) -> None:
        super().__init__()
        self.mean, self.scale = mean, scale
        self.gru = torch.nn.GRU(len(mean), CELLS, batch_first=True)
        self.out = torch.nn.Linear(CELLS, 1)

    def forward(self, visible: Floats, memory: Any = None) -> tuple[Any, Any]:
        """Return superheats (cuts, n) for features (cuts, n, k), and the state after them."""
        normal = np.clip((visible - self.mean) / self.scale, -8, 8)
        hidden, memory = self.gru(torch.as_tensor(normal, dtype=torch.float32), memory)
        return self.out(hidden)[..., 0], memory


def fitted(cuts: list[Recorded]) -> Network:
    """Return a network trained on cuts, with the mean square error as loss."""
    torch.manual_seed(0)
    everything = np.concatenate([cut.visible[cut.counts] for cut in cuts])
    network = Network(everything.mean(axis=0), everything.std(axis=0) + 1e-6)
    steps = EPOCHS * (len(cuts) // MACHINES_A_STEP)
    optimiser = torch.optim.Adam(network.parameters(), lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    rng = np.random.default_rng(0)
    for _ in range(steps):
        chosen = [cuts[k] for k in rng.choice(len(cuts), MACHINES_A_STEP, replace=False)]
        length = max(len(cut.superheat) for cut in chosen)
        visible, target, counts = (
            np.stack([np.pad(getattr(cut, name), ((0, length - len(cut.superheat)), *more)) for cut in chosen])
            for name, more in (("visible", ((0, 0),)), ("superheat", ()), ("counts", ()))
        )
        error = (network(visible)[0] - torch.as_tensor(target, dtype=torch.float32))[torch.as_tensor(counts)]
        optimiser.zero_grad()
        (error**2).mean().backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
    return network


def of_cuts(network: Network, cuts: list[Recorded]) -> list[Floats]:
    """Return a network's estimates of the superheats of cuts."""
    with torch.no_grad():
        return [network(cut.visible[None])[0][0].numpy() for cut in cuts]


def explained(cuts: list[Recorded], predicted: list[Floats]) -> tuple[float, float]:
    """Return the shares of the superheat's variance that are explained: between windows, and between machines."""
    pairs = [(cut.superheat[cut.counts], values[cut.counts]) for cut, values in zip(cuts, predicted, strict=True)]
    pairs = [pair for pair in pairs if len(pair[0]) > 1]
    missed = sum(float((((p - p.mean()) - (t - t.mean())) ** 2).sum()) for t, p in pairs)
    spread = sum(float(((t - t.mean()) ** 2).sum()) for t, _ in pairs)
    means = np.array([(t.mean(), p.mean()) for t, p in pairs])
    between = ((means[:, 0] - means[:, 1]) ** 2).sum() / ((means[:, 0] - means[:, 0].mean()) ** 2).sum()
    return 1.0 - missed / spread, 1.0 - float(between)


def boil_share(superheat: float) -> float:
    """Return a superheat on a scale from 0 at the coldest to 1 where the wire boils dry."""
    return (superheat - COLDEST) / (1.0 - COLDEST)


@dataclass
class NetworkGauge(Gauge):
    """Gauge of the wire's superheat by the network, on the scale of `boil_share`; the caller sets `network`."""

    flux: FluxGauge = field(default_factory=FluxGauge, init=False)
    age_s: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self.network: Any = None
        self._memory: Any = None

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Set the machine and the path."""
        self._machine = machine
        self.flux.set_up(machine, points_um, start_um)

    def begin(self) -> None:
        """Begin a new cut."""
        self._memory = None
        self.fresh_wire()

    def fresh_wire(self) -> None:
        """Begin with a fresh, cold wire."""
        self.age_s = 0.0
        self.flux.begin()

    def near(self, window: WindowObservation) -> float:
        """Return the network's estimate."""
        self.flux.near(window)
        self.age_s += window.duration_s
        visible = np.array([[features(window, self.flux, self.age_s, self._machine)]])
        with torch.no_grad():
            superheat, self._memory = self.network(visible, self._memory)
        return boil_share(float(superheat))


class NetworkController(
    ServoLaw, measure=OpenShare, period=HeatFluxHold, gauge=NetworkGauge, proportional_share=0.7, integral_per_s=5.0,
    **HEAT,
):  # fmt: skip
    """Law that holds the network's estimate of the wire's superheat by the period."""

    name: ClassVar[str] = "network"


def cut_with(make: Callable[[], FeedController], seed: int) -> Result:
    """Cut a machine with a law."""
    return Episode(Task(ENV_ID), make(), seed, "law").run()


def holding(network: Network, superheat: float) -> FeedController:
    """Return the law that holds a superheat with a network."""
    law = NetworkController(hold_share=boil_share(superheat))
    law.gauge.network = network
    return law


def main() -> None:
    """Record, fit, cut, and write both tables."""
    torch.set_num_threads(1)
    with ThreadPoolExecutor(2) as threads:
        learned, tested = (list(threads.map(record, seeds)) for seeds in (LEARNED, TESTED))
    known = [np.concatenate([getattr(cut, name)[cut.counts] for cut in learned]) for name in ("flux", "superheat")]
    cubic = np.polynomial.Polynomial.fit(*known, 3)
    network = fitted(learned)
    predicted = {
        "the greatest flux": [cubic(cut.flux) for cut in tested], "the network": of_cuts(network, tested),
        "a network that is shown the machine's constants": of_cuts(
            fitted([cut.with_hidden() for cut in learned]), [cut.with_hidden() for cut in tested]
        ),
    }  # fmt: skip
    shares = [[name, *map("{:.0%}".format, explained(tested, values))] for name, values in predicted.items()]
    heads = "superheat explained by", "from window to window", "between machines"
    write_sections("tasks/max-rate.md", {"observed superheat": table(heads, shares)})
    rows = []
    laws: dict[str, Callable[[], FeedController]] = {"`heat-flux`": HeatFluxController}
    laws |= {
        f"the network's superheat held at {hold:g}": partial(holding, network, hold) for hold in NETWORK_HOLDS
    }
    for name, make in laws.items():
        with ThreadPoolExecutor(2) as threads:
            made = list(threads.map(partial(cut_with, make), CUT))
        rate, lost = np.mean([result.rate_mm2_min for result in made]), sum(result.wires_lost for result in made)
        rows.append((name, f"{rate:.1f}", str(lost)))
    heads = "law", "mean rate, mm2/min", f"wires lost in {len(CUT)} cuts"
    write_sections("tasks/max-rate.md", {"held superheat": table(heads, rows)})


if __name__ == "__main__":
    main()
