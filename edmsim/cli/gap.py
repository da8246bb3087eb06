"""``edmsim gap``: the gap on serial lines, as samples, as a table of delays, as an FMU."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import say
from edmsim.cli.options import SET_UP, Unset, takes
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.hil.rig import Rig
    from edmsim.job.settings import CutSettings
    from edmsim.machine.machine import Machine


@takes("machine", SET_UP, "resolution", "seed", resolution="fast",
       generator=Unset("Default: the board's, or iso-pulse."))  # fmt: skip
def gap(
    serial: Annotated[
        str | None, typer.Option(metavar="BOARD", help="Serial ports of a board: powercore, powercore-v2, spark.")
    ] = None,
    samples: Annotated[
        Path | None,
        typer.Option(help="File for samples of gap voltage and current, .parquet or .wav."),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="File for ratios and positions, .csv, for edmsim calibrate.")
    ] = None,
    delays: Annotated[Path | None, typer.Option(help="File for quantiles of ignition delays, .csv.")] = None,
    fmu: Annotated[Path | None, typer.Option(help="File for an FMU, FMI 3.0 for co-simulation, .fmu.")] = None,
    gap: Annotated[float, typer.Option(help="Gap round the wire at the start in um.")] = 30.0,
    feed: Annotated[float, typer.Option(help="Without --serial: speed of x in um/s.")] = 5.0,
    seconds: Annotated[
        float | None, typer.Option(help="Machine time in s after which to stop; default without --serial: 1.")
    ] = None,
    speed: Annotated[float, typer.Option(help="With --serial: machine seconds per second.")] = 1.0,
    rate: Annotated[float, typer.Option(help="Samples per second, 10000 to 100000.")] = 50_000.0,
    low_pass: Annotated[
        float, typer.Option(help="Cut-off frequency of a low-pass filter before the converter in Hz; 0 for none.")
    ] = 0.0,
    noise: Annotated[float, typer.Option(help="Noise of the voltage samples, rms in V.")] = 0.0,
    current_noise: Annotated[float, typer.Option(help="Noise of the current samples, rms in A.")] = 0.0,
    log_rate: Annotated[float, typer.Option(help="Rows of --log per second, 2 to 100.")] = 10.0,
    **options: Any,
) -> None:
    """Simulate the gap for a real controller or another simulator."""
    from edmsim.files import make_writable
    from edmsim.hil.ratio_log import RatioLog
    from edmsim.hil.rig import PlainGenerator, Rig, make_board
    from edmsim.hil.samples import SampleFile, Sensing
    from edmsim.job.settings import CutSettings

    is_run = not (serial is None and samples is None and log is None)
    if not is_run and delays is None and fmu is None:
        raise InputError(
            "give --serial BOARD for ports, --samples, --log, --delays or --fmu FILE for files; see edmsim gap --help"
        )
    board = None if serial is None else make_board(serial)
    of_board = {} if board is None else {"generator": board.generator}
    settings = CutSettings.model_validate({**of_board, **options})
    set_up, seed = settings.load_machine(), settings.seed
    if fmu is not None:
        _write_fmu(settings, fmu, gap)
    if delays is not None:
        _write_delays(set_up, delays, seed)
    if not is_run:
        return
    for file in (samples, log):
        if file is not None:
            make_writable(file.parent)
    rig = Rig(board or PlainGenerator(set_up), set_up, seed=seed, gap_um=gap, resolution=settings.resolution)
    with ExitStack() as files:
        sensing = Sensing(rate, low_pass, noise, current_noise, seed)
        sampled = files.enter_context(SampleFile(samples, sensing, rig.time_s)) if samples else None
        logged = files.enter_context(RatioLog(log, rig, log_rate)) if log else None
        for taker in (sampled, logged):
            if taker is not None:
                rig.watch(taker.frame)
        _run(rig, serial is not None, speed, seconds, feed)
    if sampled is not None:
        say(f"{sampled.count} samples of {samples}" + (f": {sampled.notice}" if sampled.notice else ""))
    if rig.gap.lost and serial is None:
        say(rig.gap.lost)


def _run(rig: Rig, has_ports: bool, speed: float, seconds: float | None, feed: float) -> None:
    if has_ports:
        from edmsim.hil.session import serve

        serve(rig, speed=speed, seconds=seconds, say=say)
        return
    from edmsim.consoles.computer_1982.devices import Interrupts

    interrupts = Interrupts()
    with interrupts.caught():
        until_s = rig.time_s + (1.0 if seconds is None else seconds)
        while rig.time_s < until_s and not interrupts.pending:
            rig.gap.setpoints.move_at((feed, 0.0), rig.gap.plant.time_ns)
            rig.frame()


def _write_delays(set_up: Machine, file: Path, seed: int) -> None:
    from edmsim.files import make_writable
    from edmsim.hil.delays import delay_table, write_delays
    from edmsim.progress import ShownProgress

    make_writable(file.parent)
    with ShownProgress() as bar:
        rows = delay_table(set_up, seed=seed, watch=bar.of("delays"))
    write_delays(rows, file)
    say(f"{len(rows)} gaps and voltages in {file}")


def _write_fmu(settings: CutSettings, file: Path, gap_um: float) -> None:
    from edmsim.hil.fmu import export_fmu

    step_s = export_fmu(file, resolution=settings.resolution, gap_um=gap_um, name=settings.machine, **settings.set_up)
    say(f"written: {file}; its step is {step_s:.9g} s")
