"""Benches with an EANPOS under test: the manual's application example, 1 unit of measure (Um) for 1 um.

Its standard set is 100000 Um/min (1666.667 Um/s) at 10 V, 0.25 Um an edge, 4 ms, ramps of 1 s.
"""

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis.drive import axis_row
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.controllers.axis.eanpos.registers import COMMANDS, PARAMETERS

STANDARD = {
    "measure": 10000, "pulse": 40000, "maxvel": 100000, "maxfollerr": 10000, "taccdec": 100, "toll": 5, "toldly": 10,
    "prsvel": 20000, "sprsvel": 10000, "pgain": 10, "feedfw": 1000, "setvel": 50000, "setpos": 2000,
}  # fmt: skip
TOP = 100000 / 60
"""Speed of 10 V in um/s."""


class Positioner:
    """A bench with a device on x, or several by axis."""

    def __init__(self, *, tcamp_ms=4, resources=None, settings=None, axes="x", ready=True, **changes):
        names = {key: changes.pop(key) for key in list(changes) if key in PARAMETERS}
        motor = axis_row("analogue", **changes)
        make = lambda: Eanpos(motor, tcamp_ms, resources, {**STANDARD, **names}, settings)  # noqa: E731
        self.bench = AxisBench({name: make() for name in axes})
        self.tcamp_s = tcamp_ms * 1e-3
        self.device = self.bench.drive(axes[0])
        if ready:
            self.do("INIT", "LOOPON")

    def do(self, *commands, axis="x", run_s=0.0):
        """Give commands, let a sample take them, and run for some time."""
        for command in commands:
            self.bench.drive(axis).command(command)
        self.sample()
        if "START" in commands:
            self.began_s = self.bench.time_s
        self.run(run_s)

    def sample(self, count=1):
        """Let some samples pass; bench time stands a little behind the last of them."""
        period_ns = round(self.tcamp_s * 1e9)
        now_ns = round(self.bench.time_s * 1e9)
        self.bench.run_to((now_ns // period_ns + count) * period_ns + 1000)

    def slip(self, edges):
        """Let the encoder count some edges at once, as if the axis had been pushed."""
        for _ in range(abs(edges)):
            self.bench.slip_encoder("x", 1 if edges > 0 else -1)
        self.sample()

    def push(self, seconds=0.1):
        """Turn the shaft by a torque that is more than the amplifier holds, and let it come to rest."""
        self.bench.torque("x", 1.0)
        self.run(seconds)
        self.bench.torque("x", 0.0)
        self.run(0.3)

    def run(self, seconds):
        self.bench.run(seconds)

    @property
    def since_s(self):
        """Time from the sample of the last START to the last sample."""
        return self.bench.time_s - self.began_s

    def until(self, state, value=True, limit_s=20.0, run_s=0.0):
        """Run until a state has a value, and for some time more."""
        began = self.bench.time_s
        while self.device.states[state] != value:
            self.sample()
            assert self.bench.time_s - began < limit_s, f"{state} does not become {value}"
        self.run(run_s)

    def move(self, limit_s=60.0, run_s=0.0):
        """Send START and return the time to rest, from the sample of the command; run for some time more."""
        self.do("START")
        self.until("st_still", True, limit_s)
        since_s = self.since_s
        self.run(run_s)
        return since_s

    def __getitem__(self, name):
        device = self.device
        return device.states[name] if name.startswith("st_") else device.parameters[name]

    def __setitem__(self, name, value):
        self.device.parameters[name] = value

    @property
    def on(self):
        """States that are 1."""
        return {name for name, value in self.device.states.items() if value}

    @property
    def true_um(self):
        return float(self.bench.axis()["place_um"])

    @property
    def theory(self):
        """Theoretical place and speed."""
        return self.device.theoretical

    @property
    def warning(self):
        return self["wrncode"] if self["st_warning"] else 0

    @property
    def error(self):
        return self["errcode"] if self["st_error"] else 0


def moving(seconds=1.0, **changes):
    """Start a placement, and let it run for some time."""
    p = Positioner(**changes)
    p.do("START", run_s=seconds)
    assert not p["st_still"]
    return p


def refused(p, command):
    """Whether a command is refused: warning 1, and its number in order of priority."""
    p.do("RSWRN")
    p.do(command)
    if p.warning:
        assert (p.warning, p["wrnvalue"]) == (1, COMMANDS.index(command) + 1)
    return bool(p.warning)
