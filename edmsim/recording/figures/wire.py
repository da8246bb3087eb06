"""The figure of the wire's vibration: modes over tension, and what a simulated cut shows of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.mlab import psd

from edmsim.cosim.straight import PulseSample
from edmsim.errors import InputError
from edmsim.geometry import Floats, interpolated
from edmsim.machine.machine import Machine
from edmsim.plant.constants import modal_model
from edmsim.plant.resolution import resolution as named
from edmsim.recording.figures.palette import BLUE, GRID, INK, ORANGE, VERMILION
from edmsim.recording.figures.style import TICK_PT, column_figure, dress, legend

TENSIONS = 5  # tensions the modes are computed at; between them they are interpolated
SEGMENTS = 8  # stretches of a sample whose spectra are averaged (Welch): lines are smoother, and wider


def wire_frequencies_hz(machine: Machine, resolution: str) -> Floats:
    """Return the undamped frequencies of the wire's modes in Hz, lowest first, as the plant has them."""
    return np.asarray(modal_model(machine, named(resolution)).wire_omega / (2 * np.pi))


def folded_hz(frequency_hz: Floats, sampling_hz: float) -> Floats:
    """Return where frequencies appear when looked at once a pulse: between 0 and half the pulse frequency."""
    return np.asarray(np.abs((frequency_hz + sampling_hz / 2) % sampling_hz - sampling_hz / 2))


def spectrum(sample: PulseSample) -> tuple[Floats, Floats, Floats]:
    """Return frequencies in Hz, and power spectra along and across the feed in um^2/Hz, averaged over the slices."""
    # Welch's method of matplotlib: to load scipy.signal takes longer than to draw the whole figure
    length = max(len(sample.deflection_um) // SEGMENTS, 2)
    window = 0.5 - 0.5 * np.cos(2 * np.pi / length * np.arange(length))
    per_place = [
        psd(place_um, NFFT=length, Fs=1e6 / sample.period_us, detrend="linear", window=window, noverlap=length // 2)
        for place_um in sample.deflection_um.reshape(len(sample.deflection_um), -1).T
    ]
    power = np.array([power for power, _ in per_place]).reshape(-1, 2, length // 2 + 1)
    along, across = power.mean(axis=0)
    return np.asarray(per_place[0][1]), along, across


def spectrum_figure(samples: Sequence[PulseSample], resolution: str = "default") -> Figure:
    """Draw spectra and the wire's modes over its tension (a Campbell diagram).

    Parameters
    ----------
    samples : sequence of PulseSample
        Cuts that differ only in tension. The figure has the spectrum of the first and, if there are several,
        the spectra of all over their tensions.
    resolution : {"fast", "default", "fine"}
        Determines the number of modes.

    Returns
    -------
    matplotlib.figure.Figure
        One column wide. The wire is sampled once per pulse: frequencies above half the pulse frequency appear
        folded below it, and motion in step with the pulses appears at 0.

    Raises
    ------
    InputError
        If there is no sample, or one is too short for a spectrum.
    """
    if not samples or min(len(s.kind) for s in samples) < 4 * SEGMENTS:
        raise InputError(f"a spectrum needs a sample of at least {4 * SEGMENTS} pulses")
    first = samples[0]
    figure = column_figure(3.5, top_in=0.48)
    modes, spectrum = figure.subplots(1, 2, sharey=True, width_ratios=[1.7, 1.0], gridspec_kw={"wspace": 0.14})
    sampling_hz = 1e6 / first.period_us
    if len(samples) > 1:
        _draw_waterfall(modes, samples)
    _draw_modes(modes, first, sampling_hz, resolution)
    _draw_spectrum(spectrum, first, sampling_hz, resolution)
    modes.set_ylim(0, sampling_hz / 2e3)
    legend(modes, above=True, columns=2)
    return figure


def _draw_modes(axes: Axes, sample: PulseSample, sampling_hz: float, resolution: str) -> None:
    machine = sample.machine
    tension, frequency = _modes_over_tension(machine, resolution)
    dress(axes, "wire tension, N", "frequency, kHz")
    for number, line in enumerate(frequency.T):
        below = np.where(line <= sampling_hz / 2, line, np.nan)
        folded = np.where(line > sampling_hz / 2, folded_hz(line, sampling_hz), np.nan)
        axes.plot(tension, below / 1e3, color=INK, linewidth=1.0, label="mode" if number == 0 else None)
        style: dict[str, Any] = {"color": INK, "linewidth": 0.6, "linestyle": (0, (3, 3)), "alpha": 0.6}
        # only the first few: the higher ones crowd, and hardly move
        if number < 4 and np.isfinite(folded).any():
            axes.plot(tension, folded / 1e3, **style)
        if np.isfinite(below).sum() > 1:
            last = int(np.flatnonzero(np.isfinite(below))[-1])
            through_the_top = last < len(tension) - 1  # where the legend is
            axes.annotate(
                f"{number + 1}", (tension[last], below[last] / 1e3), xytext=(3, -6) if through_the_top else (2, 3),
                textcoords="offset points", fontsize=TICK_PT, color=INK, va="center",
            )  # fmt: skip
    axes.plot([], [], color=INK, linewidth=0.6, linestyle=(0, (3, 3)), alpha=0.6, label="mode, folded")
    axes.axvline(machine.tension, color=VERMILION, linewidth=0.8, label="set tension")
    axes.set_xlim(tension[0], tension[-1])


def _modes_over_tension(machine: Machine, resolution: str) -> tuple[Floats, Floats]:
    """Return tensions in N up to what the wire holds, and the modes' frequencies there, (tensions, modes) in Hz."""
    known = np.linspace(0.25, min(1.75, 0.99 * machine.breaking_force / machine.tension), TENSIONS) * machine.tension
    frequency = np.array([wire_frequencies_hz(machine.with_(tension=float(n)), resolution) for n in known])
    tension = np.linspace(known[0], known[-1], 200)
    # a string's frequency squared is proportional to its tension: lines between the squares are next to exact
    return tension, np.sqrt(interpolated(tension, known, frequency**2))


def _draw_waterfall(axes: Axes, samples: Sequence[PulseSample]) -> None:
    """Spectra along the feed over tension, in decades of power."""
    ordered = sorted(samples, key=lambda s: s.machine.tension)
    tension = np.array([s.machine.tension for s in ordered])
    spectra = [spectrum(s) for s in ordered]
    power = np.log10(np.maximum([along + across for _, along, across in spectra], 1e-12)).T
    axes.pcolormesh(
        tension, spectra[0][0] / 1e3, power, cmap="Blues", shading="nearest", rasterized=True, zorder=0,
        vmin=np.percentile(power, 20), vmax=power.max(),
    )  # fmt: skip


def _draw_spectrum(axes: Axes, sample: PulseSample, sampling_hz: float, resolution: str) -> None:
    frequency, along, across = spectrum(sample)
    dress(axes, "power, µm²/Hz", "")
    for hz in wire_frequencies_hz(sample.machine, resolution):
        if hz <= sampling_hz / 2:
            axes.axhline(hz / 1e3, color=GRID, linewidth=1.2, zorder=1)
    for power, colour, name in ((along, BLUE, "along feed"), (across, ORANGE, "across")):
        axes.semilogx(power[1:], frequency[1:] / 1e3, color=colour, linewidth=0.9, label=name, zorder=2)
    axes.xaxis.set_minor_formatter("")  # a short span would label them, beyond the column
    axes.grid(axis="y", visible=False)
    legend(axes, above=True, title=f"{sample.machine.tension:.3g} N, {sampling_hz / 1e3:.3g} kHz pulses")
