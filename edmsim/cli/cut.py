"""``edmsim cut``."""

from __future__ import annotations

import shlex
import signal
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import (
    ERR,
    INTERRUPTED,
    OUT,
    STOPPED,
    AfterTab,
    Conditions,
    Dialect,
    Generator,
    GuideErrors,
    Height,
    Ignore,
    Layers,
    Machine,
    Material,
    Offset,
    Offsets,
    Overlap,
    Passes,
    Program,
    Resolution,
    Seed,
    Tab,
    TaperCorners,
    TaperDeg,
    Technology,
    Tension,
    Unit,
    Upper,
    Wire,
    default_folder,
    named,
    parse_guide_errors,
    path_text,
    say,
)
from edmsim.errors import InputError


def cut(
    program: Program,
    out: Annotated[
        Path | None, typer.Option(help="Folder for report, windows, picture and recording; default out/PROGRAM.")
    ] = None,
    machine: Machine = "agiecut-dem15",
    material: Material = "tool-steel",
    height: Height = 20.0,
    height_at: Annotated[
        list[str] | None,
        typer.Option(metavar="MM:MM", help="From that length of path on, that height; may be given again."),
    ] = None,
    wire: Wire = "brass",
    tension: Tension = None,
    generator: Generator = "iso-pulse",
    t_on: Annotated[float | None, typer.Option(help="On-time in us; default by generator.")] = None,
    t_period: Annotated[float | None, typer.Option(help="Period in us; default by generator.")] = None,
    open_voltage: Annotated[float | None, typer.Option(help="Voltage until ignition; default by generator.")] = None,
    peak_current: Annotated[float | None, typer.Option(help="Peak current in A; default by generator.")] = None,
    resistance: Annotated[
        float | None, typer.Option(help="Series resistor in ohm, in place of a peak current; default by generator.")
    ] = None,
    ignition_wait: Annotated[
        float | None, typer.Option(help="Longest wait for ignition in us; default by generator.")
    ] = None,
    pulse_shape: Annotated[str | None, typer.Option(help="rectangle or triangle; default by generator.")] = None,
    wire_speed: Annotated[float | None, typer.Option(help="Wire speed in m/s; default by machine.")] = None,
    flushing_lower: Annotated[
        float | None, typer.Option(help="Pressure of the lower nozzle in Pa, 0 is off; default by machine.")
    ] = None,
    flushing_upper: Annotated[
        float | None, typer.Option(help="Pressure of the upper nozzle in Pa, 0 is off; default by machine.")
    ] = None,
    standoff_lower: Annotated[
        float | None, typer.Option(help="Distance of the lower nozzle from the workpiece in mm; default 0.")
    ] = None,
    standoff_upper: Annotated[
        float | None, typer.Option(help="Distance of the upper nozzle from the workpiece in mm; default 0.")
    ] = None,
    constant: Annotated[
        list[str] | None, typer.Option(metavar="NAME=NUMBER", help="A constant's value; may be given again.")
    ] = None,
    controller: Annotated[
        str,
        typer.Option(help="Feed controller: counts, fixed, voltage, delay, fuzzy, adaptive-off-time, mcu, "
                          "fixed-period, sato, heat-flux, set-point, climb, trim, policy:FILE, own.py:Own; with "
                          "parameters if wanted, fixed:feed_um_s=20."),
    ] = "counts",
    planner: Annotated[str, typer.Option(help="poscal, poscal-literal, dda, sine-table or exact.")] = "poscal",
    drive: Annotated[
        str,
        typer.Option(help="Drive of x and y: stepper, uhu, servo-module, eanpos; or uhu:P=600."),
    ] = "stepper",
    compensation: Annotated[
        Path | None, typer.Option(help="File of cam tables: errors to compensate, and cams of the upper guide.")
    ] = None,
    mechanics: Annotated[str, typer.Option(help="Integrator of table and wire.")] = "modal",
    resolution: Resolution = "default",
    offset: Offset = "auto",
    ignore: Ignore = "",
    offsets: Offsets = None,
    dialect: Dialect = "auto",
    conditions: Conditions = None,
    layers: Layers = "",
    upper_layer: Upper = None,
    taper_deg: TaperDeg = 0.0,
    taper_corners: TaperCorners = "conical",
    guide_errors: GuideErrors = None,
    unit: Unit = None,
    passes: Passes = None,
    technology: Technology = None,
    tab: Tab = 1.5,
    overlap: Overlap = 0.1,
    after_tab: AfterTab = "stop",
    stuck_wire_sensor: Annotated[
        bool, typer.Option("--stuck-wire-sensor", help="Let nobody see a wire break: the machine goes on.")
    ] = False,
    axis_fault: Annotated[
        list[str] | None,
        typer.Option(metavar="AXIS:FAULT@SECONDS",
                     help="What breaks at an axis under a servo drive, and when: stuck, swapped, unplugged, "
                          "supply-off, logic-off, fault-line, stalled; may be given again."),
    ] = None,
    seed: Seed = 0,
    max_time: Annotated[float | None, typer.Option(help="Machine time in s after which to stop.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the interrupted cut of the folder.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Give up the folder's interrupted cut.")] = False,
    traces: Annotated[
        Path | None, typer.Option(help="File for gap voltage and current as an oscilloscope samples them, .parquet.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Simulate a part program."""
    from edmsim.cli.progress import ProgressBar
    from edmsim.cosim.stops import WORDS, StopCause
    from edmsim.files import make_writable
    from edmsim.job.checkpoint import NAME
    from edmsim.job.cut import cut as run_cut
    from edmsim.machine.overrides import parse_constant
    from edmsim.program.heights import parse_height

    folder = default_folder(program) if out is None else out
    if traces is not None:
        if traces.suffix != ".parquet":
            raise InputError("the file for traces must end in .parquet", traces)
        make_writable(traces.parent)
    watcher, result = ProgressBar(quiet, ERR), None
    try:
        with watcher, warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: say(str(message))
            result = run_cut(
                program, out=folder, machine=machine, material=material, height_mm=height,
                heights=[parse_height(text) for text in height_at or ()], wire=wire, tension=tension,
                generator=generator, t_on_us=t_on, t_period_us=t_period, open_voltage_V=open_voltage,
                peak_current_A=peak_current, resistance_ohm=resistance, ignition_wait_us=ignition_wait,
                pulse_shape=pulse_shape, wire_speed_m_s=wire_speed, flushing_lower_Pa=flushing_lower,
                flushing_upper_Pa=flushing_upper, standoff_lower_mm=standoff_lower, standoff_upper_mm=standoff_upper,
                constants=dict(map(parse_constant, constant or ())),
                controller=controller, planner=planner, drive=drive,
                compensation=path_text(compensation), mechanics=mechanics,
                resolution=resolution, offset=offset, offsets=path_text(offsets), ignore=named(ignore),
                dialect=dialect, conditions=path_text(conditions),
                layers=named(layers), upper_layer=upper_layer, taper_deg=taper_deg, taper_corners=taper_corners,
                guide_errors_mm=parse_guide_errors(guide_errors), unit=unit, passes=passes, technology=technology,
                tab_mm=tab, overlap_mm=overlap, after_tab=after_tab, stuck_wire_sensor=stuck_wire_sensor,
                axis_faults=axis_fault or (), seed=seed, max_time_s=max_time,
                resume=resume, overwrite=overwrite,
                watch=watcher.show, enter=watcher.enter,
            )
    except KeyboardInterrupt as interrupt:
        if result is None:
            has_checkpoint = (folder / NAME).exists()
            resumable = "interrupted; the same command with --resume goes on"
            say(resumable if has_checkpoint else "interrupted before the cut began")
            number = next(iter(interrupt.args), signal.SIGINT)
            raise typer.Exit(128 + number) from None  # as shells have it
    if traces is not None:
        try:
            result.write_traces(traces)
        except KeyboardInterrupt:
            say(f"interrupted: the results are in {folder}, the traces are not written")
            raise typer.Exit(INTERRUPTED) from None
    with suppress(KeyboardInterrupt):  # all is written
        if not quiet:
            from edmsim.recording.report import render_table

            OUT.print(render_table(result.report))
            where = f"Written to {folder}; play it back with: edmsim view {shlex.quote(str(folder))}"
            OUT.print(where, highlight=False, soft_wrap=True, markup=False)
    if result.report["outcome"] != WORDS[StopCause.FINISHED].report:
        raise typer.Exit(STOPPED)
