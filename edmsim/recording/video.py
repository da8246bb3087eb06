"""``edmsim report --film``: a film of a cut, drawn from its recording without viewer, screen or GPU.

Its pictures show the part from above, the gap at the wire, the oscilloscope and the series.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from edmsim.errors import InputError
from edmsim.files import check_suffix, locked_file, make_writable, replacing
from edmsim.geometry import Floats
from edmsim.recording.figures import palette
from edmsim.recording.figures.style import in_style, shrink_to
from edmsim.recording.report import duration_text
from edmsim.recording.rerun.logs import CURRENT_HEIGHT, SCOPE_SPACE, SCOPE_WIDTH, VOLTAGE_HEIGHT, WALL_UM
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.windows import broken, pause_rows
from edmsim.signals import noted

SIZE_INCH = (12.8, 7.2)
GROUND = "#161d24"
TEXT = "#d6dbe1"
STEEL = "#8e98ac"
_CURVES = (
    ("pulses, %", (("/pulses/spark", "spark", palette.CLASS_COLOURS["spark"]), ("/pulses/open", "open", "#9aa5b1"),
                   ("/pulses/short", "short", palette.CLASS_COLOURS["short"]))),
    ("feed, µm/s", (("/feed/feed_um_s", "feed", palette.YELLOW),)),
    ("gap, lag, error, µm", (("/gap/gap_um", "gap", palette.GREEN), ("/gap/lag_um", "lag", palette.ORANGE),
            ("/gap/error_um", "error", palette.PURPLE))),
    ("gas on the wire's front, share", (("/gas/coverage", "gas", palette.GAS),)),
)  # fmt: skip
"""Title and curves of every plot: entity, name, colour. No two curves of a plot have the same colour.
Feed has the colour of the path cut, lag that of the wire."""
_WORKPIECE, _VERTICES = "/world/table/workpiece", ("positions", "normals")
_FACES_UP = 0.5  # least z component of an upper face's normal
_MOST_POINTS = 1500  # of a curve: about one per pixel


class Film:
    """Draws a recording at any time; `size` is the pictures' width and height in pixels, both even."""

    def __init__(self, play: Playback, dpi: int) -> None:
        self._play = play
        self._sizes = play.sizes
        self._figure = Figure(figsize=SIZE_INCH, dpi=dpi, facecolor=GROUND)
        self._canvas = cast("Any", FigureCanvasAgg(self._figure))  # matplotlib does not annotate its methods
        self._moving: list[tuple[Axes, Any]] = []
        grid = self._figure.add_gridspec(
            12, 3, left=0.02, right=0.985, top=0.92, bottom=0.06, hspace=1.6, wspace=0.14, width_ratios=[1, 1, 1.15]
        )
        self._part(self._axes(grid[:8, 0], "part from above"))
        self._gap(self._axes(grid[:8, 1], "at the wire, mid height; gas pale; rings of 50 µm"))
        self._scope(self._axes(grid[8:, :2], "gap voltage and current of the last pulses"))
        plots = [self._axes(grid[3 * i : 3 * i + 3, 2], title) for i, (title, _) in enumerate(_CURVES)]
        self._cursors = [self._plot(axes, curves) for axes, (_, curves) in zip(plots, _CURVES, strict=True)]
        for axes in plots[:-1]:
            axes.tick_params(labelbottom=False)  # the last plot's labels serve all
        plots[-1].set_xlabel("machine time, s", color=TEXT, fontsize=8, labelpad=2)
        name = self._figure.text(0.02, 0.965, play.title, color=TEXT, fontsize=13, weight="bold", va="center")
        shrink_to(name, 0.8 * self._figure.bbox.x1)  # the heading needs the rest
        self._heading = self._figure.text(
            0.985, 0.965, "", color=TEXT, fontsize=12, va="center", ha="right", animated=True
        )
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._figure.bbox)
        width, height = self._canvas.get_width_height()
        self.size = (width // 2 * 2, height // 2 * 2)

    def picture(self, t_s: float) -> NDArray[np.uint8]:
        """Return the picture (height, width, 3) at a machine time."""
        self._set_part(t_s)
        self._set_gap(t_s)
        self._set_scope(t_s)
        for cursor in self._cursors:
            cursor.set_xdata([t_s, t_s])
        path_um = float(np.interp(t_s, *self._path))
        self._heading.set_text(f"{duration_text(t_s)}   {path_um / 1000.0:.2f} mm")
        self._canvas.restore_region(self._still)
        for axes, artist in self._moving:
            axes.draw_artist(artist)
        self._figure.draw_artist(self._heading)
        width, height = self.size
        return np.asarray(self._canvas.buffer_rgba())[:height, :width, :3].copy()

    def _axes(self, place: Any, title: str) -> Axes:
        axes = self._figure.add_subplot(place)
        axes.set_facecolor(GROUND)
        axes.set_title(title, color=TEXT, fontsize=9, loc="left", pad=4)
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_color("#3a444f")
        return axes

    def _move(self, axes: Axes, artist: Any) -> Any:
        artist.set_animated(True)
        self._moving.append((axes, artist))
        return artist

    # --- the part ------------------------------------------------------------------------------------------

    def _part(self, axes: Axes) -> None:
        s = self._sizes
        middle = (s.x0_mm + s.x1_mm) / 2, (s.y0_mm + s.y1_mm) / 2
        side = max(s.x1_mm - s.x0_mm, s.y1_mm - s.y0_mm, 1.0)
        reach = side / 2 + max(0.12 * side, 2e-3 * s.wire_diameter_um)  # also shows the kerf around small parts
        axes.set_aspect("equal")
        axes.set_xlim(middle[0] - reach, middle[0] + reach)
        axes.set_ylim(middle[1] - reach, middle[1] + reach)
        self._metal = self._move(axes, axes.add_collection(PolyCollection([], facecolors=STEEL, antialiased=False)))
        nominal = [line[:, :2] for line in self._play.strips("/world/table/nominal/top", "LineStrips3D:strips", 0.0)]
        self._move(axes, axes.add_collection(LineCollection(nominal, colors=TEXT, linewidths=1.0)))
        self._done = self._move(axes, *axes.plot([], [], color=palette.YELLOW, linewidth=1.3))
        self._wire = self._move(axes, *axes.plot([], [], "o", color=palette.ORANGE, markersize=5))
        rows = self._play.rows("/position/x_um", "Scalars:scalars")
        self._path = (rows.t_s, rows.path_um)
        begins = pause_rows(rows.t_s)
        self._pauses_s = np.column_stack([rows.t_s[begins - 1], rows.t_s[begins]])
        done = self._play.rows("/world/table/done", "LineStrips3D:strips")
        ends_mm = np.asarray(done.values.flatten().flatten().flatten()).reshape(-1, 2, 3)[:, 1, :2]
        middle_s = self._pauses_s.mean(axis=1)
        begins = np.searchsorted(done.t_s, middle_s)
        self._wire_path = (np.insert(done.t_s, begins, middle_s), broken(ends_mm, begins))
        uncut = self._upper_faces(0.0)
        z_mm = uncut[:, 0, 2]
        self._above = {  # by height of an upper face before the cut, the area where the workpiece is higher
            z: shapely.union_all(shapely.polygons(uncut[z_mm > z, :, :2])) for z in np.unique(z_mm).tolist()
        }

    def _set_part(self, t_s: float) -> None:
        # if the wire leans, every layer has an upper face, and most of these are inside the workpiece
        shown = [np.zeros((0, 3, 3))]
        faces = self._upper_faces(t_s)
        for z, above in self._above.items():
            level = faces[faces[:, 0, 2] == z]
            shown.append(level[~shapely.contains_xy(above, level.mean(axis=1)[:, :2])])
        self._metal.set_verts(np.concatenate(shown)[:, :, :2])
        at = int(np.searchsorted(self._wire_path[0], t_s, side="right"))
        done = self._wire_path[1][:at]
        self._done.set_data(*_thinned(done).T)
        self._wire.set_data(*done[np.isfinite(done[:, 0])][-1:].T)

    def _upper_faces(self, t_s: float) -> Floats:
        """Return the triangles (n, 3, 3) of the workpiece whose normals point upwards, in mm."""
        corners, normals = (self._play.points(_WORKPIECE, f"Mesh3D:vertex_{name}", t_s) for name in _VERTICES)
        faces = self._play.points(_WORKPIECE, "Mesh3D:triangle_indices", t_s)
        return np.asarray(corners[faces[normals[faces[:, 0], 2] > _FACES_UP]], np.float64)

    # --- the gap -------------------------------------------------------------------------------------------

    def _gap(self, axes: Axes) -> None:
        radius = self._sizes.wire_diameter_um / 2
        reach = radius + 70.0
        axes.set_aspect("equal")
        axes.set_xlim(-reach, reach)
        axes.set_ylim(reach, -reach)  # y is recorded downwards
        for ring in np.arange(50.0, reach, 50.0):
            axes.add_patch(Circle((0.0, 0.0), ring, fill=False, color="#2d3742", linewidth=0.7))
        self._round = self._move(axes, axes.add_patch(Circle((0.0, 0.0), radius, color="#7c5c1e")))
        gas = LineCollection([], colors=palette.GAS, alpha=0.7, capstyle="round")
        self._gas = self._move(axes, axes.add_collection(gas))
        self._rays = self._move(axes, axes.add_collection(LineCollection([], linewidths=1.4)))
        self._um_points = min(axes.bbox.width, axes.bbox.height) * 72.0 / self._figure.dpi / (2 * reach)
        wall = LineCollection([], colors=STEEL, linewidths=2 * WALL_UM * self._um_points)
        self._wall = self._move(axes, axes.add_collection(wall))
        self._sparks = self._move(axes, axes.scatter([], [], s=14, zorder=5))

    def _set_gap(self, t_s: float) -> None:
        centre = self._play.points("/top/wire", "Points2D:positions", t_s)
        if len(centre):
            self._round.set_center(centre[0])
        self._rays.set_segments(self._play.strips("/top/rays", "LineStrips2D:strips", t_s))
        self._rays.set_color(rgb01(self._play.points("/top/rays", "LineStrips2D:colors", t_s)))
        self._wall.set_segments(self._play.strips("/top/metal", "LineStrips2D:strips", t_s))
        self._gas.set_segments(self._play.strips("/top/gas", "LineStrips2D:strips", t_s))
        self._gas.set_linewidths(2 * self._um_points * self._play.points("/top/gas", "LineStrips2D:radii", t_s))
        self._sparks.set_offsets(self._play.points("/top/discharges", "Points2D:positions", t_s).reshape(-1, 2))
        self._sparks.set_facecolor(rgb01(self._play.points("/top/discharges", "Points2D:colors", t_s)))

    # --- the oscilloscope ----------------------------------------------------------------------------------

    def _scope(self, axes: Axes) -> None:
        low = VOLTAGE_HEIGHT + SCOPE_SPACE + CURRENT_HEIGHT
        axes.set_xlim(-24.0, SCOPE_WIDTH + 24.0)
        axes.set_ylim(low + 14.0, -6.0)
        grid = self._play.strips("/scope/grid", "LineStrips2D:strips", 0.0)
        axes.add_collection(LineCollection(grid, colors="#2d3742", linewidths=0.7))
        places = self._play.points("/scope/scale", "Points2D:positions", 0.0)
        labels = self._play.points("/scope/scale", "Points2D:labels", 0.0)
        for (x, y), text in zip(places, labels, strict=True):
            axes.text(x, y, text, color=TEXT, fontsize=7, ha="right" if x < 0 else "center", va="center")
        self._traces = {
            name: self._move(axes, axes.add_collection(LineCollection([], linewidths=1.3)))
            for name in ("voltage", "current")
        }

    def _set_scope(self, t_s: float) -> None:
        for name, lines in self._traces.items():
            lines.set_segments(self._play.strips(f"/scope/{name}", "LineStrips2D:strips", t_s))
            lines.set_color(rgb01(self._play.points(f"/scope/{name}", "LineStrips2D:colors", t_s)))

    # --- the series ----------------------------------------------------------------------------------------

    def _plot(self, axes: Axes, curves: tuple[tuple[str, str, str], ...]) -> Any:
        axes.tick_params(colors=TEXT, labelsize=7, length=2)
        axes.yaxis.set_major_locator(MaxNLocator(nbins=4))
        axes.xaxis.set_major_locator(MaxNLocator(nbins=4))
        for begin, end in self._pauses_s:
            axes.axvspan(begin, end, facecolor="none", edgecolor="#3a444f", hatch="////", linewidth=0)
        shown = [np.zeros(1)]
        for entity, name, colour in curves:
            t_s, values = self._play.series(entity)
            curve = broken(np.column_stack([t_s, values]), np.searchsorted(t_s, self._pauses_s.mean(axis=1)))
            axes.plot(*_thinned(curve).T, color=colour, linewidth=0.9, label=name)
            shown.append(np.percentile(values, (0.5, 99.5)) if len(values) else np.zeros(0))
        low, high = np.concatenate(shown).min(), np.concatenate(shown).max()
        margin = 0.08 * ((high - low) or 1.0)
        axes.set_ylim(low - margin, high + margin)
        axes.set_xlim(0.0, self._play.end_s)
        if len(curves) > 1:  # the title names a single curve; next to it, a legend hides no curve
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), fontsize=7, ncols=len(curves), frameon=False,
                        labelcolor=TEXT, borderaxespad=0.1, handlelength=1.2, columnspacing=1.0)
        return self._move(axes, axes.axvline(0.0, color=TEXT, linewidth=0.9))


def _thinned(line: Floats) -> Floats:
    """Return about one point (n, 2) of a line per pixel, and all NaN, at which it breaks."""
    step = max(1, len(line) // _MOST_POINTS)
    chosen = np.isnan(line[:, 1])
    chosen[::step] = True
    return line[chosen]


def rgb01(colours: NDArray[Any]) -> Floats:
    """Return recorded colours, 0xRRGGBBAA, as (n, 4) numbers from 0 to 1."""
    return np.asarray(colours, ">u4").view(np.uint8).reshape(-1, 4) / 255.0


MP4, GIF = ".mp4", ".gif"
FRAMES_PER_S = {MP4: 25, GIF: 10}  # a film should be smooth, an animated picture small
DPI = {MP4: 100, GIF: 60}  # of a figure of `edmsim.recording.video.SIZE_INCH`: 1280 x 720 and 768 x 432
SECONDS = 12.0  # length of the film of a whole cut
_GIF_COLOURS = 96


@in_style
def render(recording: str | Path, out: str | Path, seconds: float = SECONDS) -> None:
    """Write a film of a cut.

    Parameters
    ----------
    recording : path
        ``cut.rrd`` of a cut.
    out : path
        A ``.mp4`` or ``.gif`` file; replaced only when complete.
    seconds : float
        Length of the film, 0.5 to 600; machine time passes evenly.

    Raises
    ------
    InputError
        If the suffix is another, the length is out of range, the file cannot be written, the recording has no
        windows, or the writer of mp4 is not installed; or as `edmsim.recording.rerun.playback.find_recording`.
    """
    target = Path(out)
    kind = check_film(target, seconds)
    play = Playback(recording)
    if play.end_s <= 0.0:
        raise InputError("the recording holds no window, there is nothing to show", recording)
    film = Film(play, DPI[kind])
    times = np.linspace(0.0, play.end_s, max(2, round(seconds * FRAMES_PER_S[kind])))
    with locked_file(target, "edmsim report"), noted() as interrupts, replacing(target) as partial:
        interrupts.at_once()  # because a command ended by SIGTERM would leave the part of the film and its lock
        (_write_mp4 if kind == MP4 else _write_gif)(partial, (film.picture(t) for t in times), film.size)


def check_film(target: Path, seconds: float) -> str:
    """Return a film's kind, `MP4` or `GIF`, after checking length, folder and writer; errors as `render`."""
    kind = check_suffix(target, "a film", MP4, GIF)
    if not 0.5 <= seconds <= 600.0:
        raise InputError(f"a film of {seconds:g} s cannot be made: give 0.5 to 600 s")
    if kind == MP4:
        _ffmpeg()
    make_writable(target.parent)
    return kind


def _ffmpeg() -> Any:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise InputError("mp4 needs imageio-ffmpeg: pip install 'edmsim[video]'; a .gif needs nothing more") from None
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
    images = map(Image.fromarray, pictures)
    first = next(images).quantize(_GIF_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    # all pictures have the colours of the first, because grey areas would flicker otherwise
    others = [image.quantize(palette=first, dither=Image.Dither.NONE) for image in images]
    duration_ms = round(1000 / FRAMES_PER_S[GIF])
    # `optimize` makes unchanged pixels transparent, which saves more than half the bytes
    first.save(
        file, format="GIF", save_all=True, append_images=others, duration=duration_ms, loop=0, optimize=True,
        disposal=1,
    )
