"""How finely the plant is resolved, by name."""

from dataclasses import dataclass

from edmsim.errors import refuse_unknown


@dataclass(frozen=True)
class Resolution:
    """How finely the plant is resolved."""

    # slices of the workpiece's height, rays around the wire, modes of the wire in each plane
    slices: int
    rays: int
    modes: int
    # side of a cell of the kerf field: small against the gap, large enough for a few MB per 10 mm
    cell_um: float = 4.0
    # front gap in the kerf below which a slice's own film is followed pulse by pulse; the mean film of all slices
    # damps the wire at any gap
    film_from_um: float = 12.0
    # spans into which the time from a discharge to the period's end is cut where a slice's own film is followed
    film_spans: int = 1
    # windows after which what fell on the rays is carved from the field and they are traced again
    trace_windows: int = 1


RESOLUTIONS: dict[str, Resolution] = {
    "fast": Resolution(5, 24, 4, cell_um=6.0, trace_windows=4),
    "default": Resolution(9, 64, 8),
    "fine": Resolution(15, 128, 16, film_spans=2),
}


def resolution(name: str | Resolution) -> Resolution:
    """Look up a resolution by name; an own one is returned as it is."""
    if isinstance(name, Resolution):
        return name
    refuse_unknown("resolution", name, RESOLUTIONS)
    return RESOLUTIONS[name]
