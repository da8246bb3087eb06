"""Spikes on an encoder's wires: none unless asked for, the same for a seed, and what a chip's input sees of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import edmsim
from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import FREEWHEEL
from edmsim.controllers.axis import ServoModule, Uhu, tuned
from edmsim.controllers.axis.drive import axis_names, axis_row
from edmsim.controllers.axis.uhu.registers import O as OVERRUNS

from .puppet import Puppet, put_out

NOISE = {"spike_rate_Hz": 500.0, "spike_s": 20e-6}


def noisy(drive, seed=0, **changes):
    """A bench with a drive whose encoder has spikes."""
    for name, value in {**NOISE, **changes}.items():
        drive.motor[name] = value
    return AxisBench({"x": drive}, seed=seed)


def history(bench, seconds=0.1):
    bench.trace = True
    bench.run(seconds)
    return bench.samples("x").tobytes(), bench.axis("x").tobytes()


def test_no_axis_of_the_files_has_spikes():
    for name in axis_names():
        bench = AxisBench({"x": Puppet(axis_row(name))})
        bench.run(0.2)
        assert bench.axis("x")["noise_draws"] == bench.axis("x")["edges"] == 0


def test_the_same_seed_gives_the_same_spikes_to_the_bit_and_another_one_others():
    first, again, other = (history(noisy(tuned("uhu"), seed)) for seed in (3, 3, 4))
    assert first == again
    assert first != other


def test_a_snapshot_amid_a_spike_continues_bit_for_bit():
    bench = noisy(Puppet(axis_row("bench")), spike_s=1e-3)
    while bench.axis("x")["disturbed"] == 0:
        bench.run(1e-4)
    state = bench.snapshot()
    first = history(bench)
    bench.restore(state)
    assert history(bench) == first


def test_spikes_come_at_their_rate_and_those_the_input_is_too_slow_for_are_not_seen():
    """Of spikes of a mean length w the share exp(-1 / (rate w)) is longer than 1 / rate; two of three move counts."""
    for rate_Hz, passes in ((1e6, math.exp(-0.05)), (50e3, math.exp(-1.0))):
        bench = noisy(Puppet(axis_row("bench")))
        bench.drive("x").record["count_rate_Hz"] = rate_Hz
        put_out(bench, FREEWHEEL)
        bench.run(10.0)
        row = bench.axis("x")
        assert row["edges"] / 2 + row["illegal"] / 2 == pytest.approx(5_000 * passes, rel=0.06)
        assert row["illegal"] / row["edges"] == pytest.approx(0.5, rel=0.1)
        assert abs(row["count"]) <= 1  # a spike that is on now is all that can be left


def test_spikes_on_a_moving_axis_cost_counts_where_an_edge_falls_into_them():
    bench = noisy(Puppet(axis_row("bench")), spike_rate_Hz=3e3)
    bench.drive("x").record["real"][0, 0] = 0.5
    bench.run(1.0)
    row = bench.axis("x")
    assert row["true_count"] > 5_000
    assert abs(row["true_count"] - row["count"]) > 4


def test_the_uhu_counts_spikes_on_both_wires_as_overruns_and_stays_where_it_is():  # U-24, U-50
    bench = noisy(Uhu(axis_row("bench"), stored={}))
    bench.run(1.0)
    assert bench.drive("x").record["reg"][0, OVERRUNS] > 100
    assert bench.pins("x").enabled
    assert abs(bench.axis("x")["true_count"]) <= 2


def test_the_module_s_filter_keeps_spikes_out():  # M-29
    edges = {}
    for divider in (0, 6):
        bench = noisy(ServoModule(axis_row("table"), {"encoder_filter": divider}), spike_s=10e-6)
        bench.run(1.0)
        edges[divider] = int(bench.axis("x")["edges"] + bench.axis("x")["illegal"])
    assert edges[0] > 500
    assert edges[6] < 0.05 * edges[0]


@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
def test_a_plant_s_seed_draws_the_spikes_of_its_axes(mechanics):
    def counts(seed):
        drive = tuned("uhu")
        drive.motor["spike_rate_Hz"], drive.motor["spike_s"] = 2e3, 20e-6
        plant = edmsim.Plant(edmsim.Machine.load(), seed, resolution="fast", mechanics=mechanics, drives={"x": drive})
        plant.switch_generator(False)
        plant.advance()
        row = plant.snapshot()["axes"][0]
        return tuple(int(row[name]) for name in ("noise_draws", "edges", "illegal"))

    assert counts(1) == counts(1) != counts(2)
    assert np.all(np.array(counts(1)) > 5)
