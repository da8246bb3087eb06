"""Resolutions of the plant by name."""

from dataclasses import dataclass

from edmsim.errors import refuse_unknown


@dataclass(frozen=True)
class Resolution:
    """Resolution of the plant."""

    # slices of the workpiece's height, rays around the wire, modes of the wire in each plane
    slices: int
    rays: int
    modes: int
    # side of a cell of the kerf field: small against the gap, large enough for a few MB per 10 mm
    cell_um: float = 4.0
    # front gap in the kerf below which the film of a single slice is applied in every pulse; the mean film of all
    # slices damps the wire at any gap
    film_from_um: float = 12.0
    # number of parts of the time from a discharge to the end of the period, if the film of a single slice is applied
    film_spans: int = 1
    # number of windows after which craters are carved from the field and the rays are traced again
    trace_windows: int = 1


RESOLUTIONS: dict[str, Resolution] = {
    "fast": Resolution(5, 24, 4, cell_um=6.0, trace_windows=4),
    "default": Resolution(9, 64, 8),
    "fine": Resolution(15, 128, 16, film_spans=2),
}


def resolution(name: str | Resolution) -> Resolution:
    """Return a resolution by its name; a `Resolution` is returned unchanged."""
    if isinstance(name, Resolution):
        return name
    refuse_unknown("resolution", name, RESOLUTIONS)
    return RESOLUTIONS[name]
