"""A test bench for drives: axes with drive, motor, encoder, screw and table, without the rest of the machine.

>>> from edmsim.axis_bench import AxisBench
>>> from edmsim.controllers import axis
>>> bench = AxisBench({"x": axis.make("servo")})
>>> bench.steps("x", 5, rate_Hz=500.0)
>>> bench.run(0.05)
>>> round(float(bench.axis("x")["place_um"]))
10
"""

from edmsim.axis_bench.bench import AxisBench, Pins

__all__ = ["AxisBench", "Pins"]
