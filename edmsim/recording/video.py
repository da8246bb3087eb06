"""``edmsim render``: a film of a cut, drawn from its recording without viewer, screen or GPU."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.files import replacing
from edmsim.recording.film import Film
from edmsim.recording.rerun.playback import Playback

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

MP4, GIF = ".mp4", ".gif"
FRAMES_PER_S = {MP4: 25, GIF: 10}
"""A film is smooth, an animated picture small."""
DPI = {MP4: 100, GIF: 60}
"""Of a figure of `edmsim.recording.film.SIZE_INCH`: 1280 x 720 and 768 x 432."""
SECONDS = 12.0
"""How long a whole cut takes in the film."""
_GIF_COLOURS = 96
_SAME = 255
"""Colour of a pixel that is as in the picture before; none of `_GIF_COLOURS`."""


def render(recording: Path, out: str | Path, seconds: float = SECONDS) -> None:
    """Write a film of a cut.

    Parameters
    ----------
    recording : path
        Of a cut.
    out : path
        A file ending in ``.mp4`` or ``.gif``; replaced whole or not at all.
    seconds : float
        How long the film is, 0.5 to 600; machine time passes evenly.

    Raises
    ------
    InputError
        Another ending, a length out of range, a file that cannot be written; no windows in the recording; what
        writes mp4 is not installed; or as `edmsim.recording.rerun.playback.find_recording` for the recording.
    """
    target = Path(out)
    kind = check_film(target, seconds)
    play = Playback(recording)
    if play.end_s <= 0.0:
        raise InputError("the recording holds no window, there is nothing to show", recording)
    film = Film(play, DPI[kind])
    times = np.linspace(0.0, play.end_s, max(2, round(seconds * FRAMES_PER_S[kind])))
    with replacing(target) as partial:
        (_write_mp4 if kind == MP4 else _write_gif)(partial, (film.picture(t) for t in times), film.size)


def check_film(target: Path, seconds: float) -> str:
    """Return a film's kind, `MP4` or `GIF`, after a look at what could go wrong; errors as `render`."""
    kind = target.suffix.lower()
    if kind not in FRAMES_PER_S:
        raise InputError(f"'{target.suffix}' is no film that can be made: let the file end in {MP4} or {GIF}", target)
    if not 0.5 <= seconds <= 600.0:
        raise InputError(f"a film of {seconds:g} s cannot be made: give 0.5 to 600 s")
    if kind == MP4:
        _ffmpeg()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        existed = target.exists()
        with target.open("ab"):
            pass
        if not existed:
            target.unlink()
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", target) from None
    return kind


def _ffmpeg() -> Any:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise InputError(
            "mp4 needs imageio-ffmpeg: pip install 'edmsim[video]'; a .gif needs nothing more"
        ) from None
    return imageio_ffmpeg


def _write_mp4(file: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int]) -> None:
    writer = _ffmpeg().write_frames(
        str(file), size, fps=FRAMES_PER_S[MP4], macro_block_size=2, ffmpeg_log_level="error",
        output_params=["-f", "mp4"],
    )
    writer.send(None)
    for picture in pictures:
        writer.send(np.ascontiguousarray(picture))
    writer.close()


def _write_gif(file: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int]) -> None:
    from PIL import Image

    frames: list[Picture] = []
    colours: Picture | None = None
    before: NDArray[np.uint8] | None = None
    for picture in pictures:
        image = Image.fromarray(picture)
        # the first picture's colours serve all, or grey areas would flicker
        shown = (
            image.quantize(palette=colours, dither=Image.Dither.NONE)
            if colours is not None
            else image.quantize(_GIF_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        )
        colours = colours or shown
        pixels = np.asarray(shown, np.uint8)
        # what is as in the picture before is left transparent: less than half the bytes
        new = pixels if before is None else np.where(pixels == before, _SAME, pixels).astype(np.uint8)
        kept = Image.fromarray(new)
        kept.putpalette(colours.getpalette() or [])
        frames.append(kept)
        before = pixels
    duration_ms = round(1000 / FRAMES_PER_S[GIF])
    frames[0].save(
        file, format="GIF", save_all=True, append_images=frames[1:], duration=duration_ms, loop=0, optimize=False,
        transparency=_SAME, disposal=1,
    )
