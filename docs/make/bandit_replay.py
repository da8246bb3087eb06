"""How much of its best settings' return a bandit earns, replayed in seconds from the recordings of its training.

python docs/make/bandit_replay.py out/adapt      # the folder of an `edmsim train ... --algo bandit`

Every machine is replayed with the prior of the others. The effects of its settings are estimated from its recording
with the same prior, so that the noise of few segments does not count as an effect. Lost wires cost their time; the
law's caution after a break is neglected.
"""

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from headroom import shown

from edmsim.evaluation.compare import ratio
from edmsim.learning import bandit
from edmsim.learning.bandit import BanditController, BanditSettings, Belief, History, Segment

ENV_ID = "edmsim/MaxRateShift-v0"
SHIFT_S, TEST_S, THREADING_S = 1200.0, 60.0, 20.0
REPEATS = 20


class Known(NamedTuple):
    """Effects of settings on a machine."""

    effects: np.ndarray  # (settings, 3): see `edmsim.learning.bandit.QUANTITIES`
    lost_per_s: np.ndarray  # (settings,)

    def net(self, lost_s: float) -> np.ndarray:
        """Return each setting's rate, with the time for wires that it loses, relative to the machine's mean."""
        return np.asarray(np.exp(self.effects[:, 0]) / (1.0 + self.lost_per_s * lost_s))


def read(folder: Path) -> tuple[BanditSettings, list[History]]:
    """Return the settings and the recordings of a training."""
    lines = [json.loads(line) for line in (folder / bandit.HISTORIES).read_text().splitlines()]
    settings = BanditSettings.model_validate({**lines[0]["of"]["settings"], "machines": len(lines) - 1})
    return settings, [History(row["rows"], row["lost"], row["cut_s"]) for row in lines[1:]]


def known(controller: BanditController, history: History) -> tuple[Known, float]:
    """Return the effects of the settings in a recording, with the prior of other machines, and the mean rate."""
    count, belief = len(controller.card.settings), Belief(controller.card)
    for setting, open_, short, seconds, area in history.rows:
        if seconds > 0 and area > 0:
            belief.learn(int(setting), Segment(float(np.log(area / seconds)), open_, short))
    effects = belief.mean.reshape(3, count).T.copy()
    level = float(np.exp(effects[:, 0].mean()))
    effects[:, 0] -= effects[:, 0].mean()
    prior = np.array(controller.card.breaks) * controller.card.breaks_s
    return Known(effects, (prior + history.lost) / (controller.card.breaks_s + np.array(history.cut_s))), level


def shift(controller: BanditController, machine: Known, rng: np.random.Generator) -> float:
    """Return a bandit's simulated return of a shift, relative to the machine's mean rate."""
    card, lost_s = controller.card, THREADING_S + controller.card.start_s
    controller.lost_s, total, time_s, offset = lost_s, 0.0, 0.0, 0.0
    controller.reset(400.0)
    while time_s < SHIFT_S:
        setting = controller.setting
        rate, *shares = machine.effects[setting]
        offset += card.offset_drift * rng.normal()
        lost = int(rng.poisson(machine.lost_per_s[setting] * card.segment_s))
        if time_s >= TEST_S:
            total += card.segment_s * float(np.exp(rate))
        time_s += card.segment_s + lost * lost_s
        controller.spent_s += card.segment_s
        controller.belief.cut_s[setting] += card.segment_s
        controller.belief.lost[setting] += lost
        noisy = np.array([rate + offset, *shares]) + card.noise * rng.normal(size=3)
        controller.learn(Segment(*map(float, noisy)))
        controller.setting = controller.choose()
    return total


def main() -> None:
    """Print the returns of the bandit and of each machine's best setting, relative to the first setting."""
    parser = argparse.ArgumentParser(description="Replay a bandit's training.")
    parser.add_argument("folder", type=Path)
    settings, histories = read(parser.parse_args().folder)
    rng, rows = np.random.default_rng(0), []
    for number, history in enumerate(histories):
        others = bandit.prior_of([*histories[:number], *histories[number + 1 :]], settings)
        card = bandit.card_of(ENV_ID, settings, others, "", 0, 0)
        controller = BanditController(card)
        machine, level = known(controller, history)
        net = machine.net(THREADING_S + settings.start_s)
        tried = np.mean([shift(controller, machine, rng) for _ in range(REPEATS)]) / (SHIFT_S - TEST_S)
        rows.append((level * net[0], level * tried, level * net.max()))
    first, tried, best = np.array(rows).T
    for name, returns in (("the bandit", tried), ("the best setting of each machine", best)):
        part = ratio(100 * returns, first)
        print(f"{name}: {shown(part, 1)} % of the first setting")


if __name__ == "__main__":
    main()
