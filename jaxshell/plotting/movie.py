"""Moving pictures of runs, as GIF or MP4: deformed shapes on one scale and in one window, several runs side by side."""

import contextlib
import itertools
import math
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxshell.numerics.checks import check_choice, check_positive_number
from jaxshell.plotting import rendering
from jaxshell.plotting.colouring import Colouring, colouring
from jaxshell.plotting.panels import frame, scale_bar, triad
from jaxshell.plotting.projection import View, Window, chosen_view, window_of
from jaxshell.plotting.shapes import whole
from jaxshell.plotting.style import STYLE, WIDTH, length_unit, scaled, title
from jaxshell.plotting.titles import named_runs
from jaxshell.results.solution import Solution

_SECONDS, _FPS, _SLOWEST = 8.0, 25.0, 5.0
"""How long a film is, and its pictures to a second, where neither is said: fewer pictures, down to _SLOWEST a second,
where so many are not stored."""
_PIXELS, _LEAST_DOTS = 1280, 90.0
"""Width of a film, and pixels to an inch of the smallest ones, in which text can still be read."""
_MOST_VIEWED = 12
"""The view is chosen by so many of the shapes."""
KINDS = (".gif", ".mp4")


class _Film(NamedTuple):
    """What is shown when."""

    runs: dict[str, Solution]
    field: str
    numbers: list[list[int]]
    """Of each run, the stored frame in each picture."""
    times: np.ndarray
    """Of the pictures."""


def animate(
    solutions: Mapping[str, Solution] | Solution,
    path,
    field: str = "displacement",
    *,
    fps: float | int | None = None,
    duration: float | int | None = None,
    size: Sequence[int] | None = None,
    renderer: str = "auto",
) -> Path:
    """Write a film of the deformed shapes of one run, or of several side by side, to a .gif or .mp4 file.

    Arguments:
        field: what colours the shapes: "displacement", "velocity", "mesh error", or a gauge's text such as "von mises
            top".
        fps: pictures to a second.
        duration: of the film [s]. Pictures are spread evenly over the runs' time, each the stored frame that is
            nearest. Where neither is given, 8 s at 25 pictures a second, or fewer and slower ones where the runs have
            fewer frames.
        size: (width, height) in pixels, made even; the default has 1280 across and a height that suits the shapes.
        renderer: as of `figures`.

    Returns the path. Raises ValueError for another ending, sizes and speeds out of range, a field that the section does
    not have, and runs without two frames; ImportError for .mp4 without imageio-ffmpeg.
    """
    path = Path(path)
    if path.suffix.lower() not in KINDS:
        raise ValueError(f"A film is a {' or '.join(KINDS)} file, but the path is {str(path)!r}.")
    write = _write_gif if path.suffix.lower() == ".gif" else _writer_of_mp4()
    check_choice("renderer", renderer, rendering.RENDERERS)
    runs = named_runs(solutions)
    fps, count = _pace(runs, fps, duration)
    film = _film(runs, field, count)
    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE):
        write(path, _pictures(film, _checked_size(size), renderer), fps)
    return path


def _pace(runs: Mapping[str, Solution], fps: float | int | None, duration: float | int | None) -> tuple[float, int]:
    """Pictures to a second, and how many."""
    for name, value in (("fps", fps), ("duration", duration)):
        if value is not None:
            check_positive_number(name, value)
    stored = max(len(run.frame_times) for run in runs.values())
    if stored < 2:
        raise ValueError("A film needs two frames: the run has stopped in its first step, or kept none.")
    if duration is not None:
        fps = _FPS if fps is None else fps
        return float(fps), max(2, round(duration * fps))
    count = min(stored, max(2, round(_SECONDS * (_FPS if fps is None else fps))))
    return (float(fps), count) if fps is not None else (float(np.clip(count / _SECONDS, _SLOWEST, _FPS)), count)


def _film(runs: dict[str, Solution], field: str, count: int) -> _Film:
    stored = [np.asarray(run.frame_times) for run in runs.values()]
    times = np.linspace(min(t[0] for t in stored), max(t[-1] for t in stored), count)
    numbers = [np.abs(t[:, None] - times).argmin(axis=0).tolist() for t in stored]
    return _Film(runs, field, numbers, times)


def _checked_size(size) -> tuple[int, int] | None:
    if size is None:
        return None
    try:
        width, height = (int(side) for side in size)
    except (TypeError, ValueError):
        raise ValueError(f"size must be (width, height) in pixels, but it is {size!r}.") from None
    if not (64 <= width <= 8192 and 64 <= height <= 8192):
        raise ValueError(f"size must be of 64 to 8192 pixels each way, but it is {width} by {height}.")
    return width - width % 2, height - height % 2


def _pictures(film: _Film, size: tuple[int, int] | None, renderer: str) -> Iterator[np.ndarray]:
    """(height, width, 3) of each picture."""
    runs = list(film.runs.values())
    coloured = colouring(runs, film.numbers, film.field)
    view, window = _stage(film)
    width, height = size or _usual_size(window, len(runs))
    dots = max(width / WIDTH, _LEAST_DOTS)
    painter = rendering.renderer(renderer, 1.2 * dots)
    figure = Figure(figsize=(width / dots, height / dots), dpi=dots, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(runs), squeeze=False)[0]
    clock = _furnish(figure, panels, film, coloured, view, window)
    count = len(film.times)
    for picture in range(count):
        drawn = []
        for which, (run, panel) in enumerate(zip(runs, panels, strict=True)):
            u = np.asarray(run.frame(film.numbers[which][picture]).displacements)
            sheet = whole(run.scene, u, coloured.values[which * count + picture])
            drawn.append(painter.draw(panel, [sheet], view, window, coloured.colours))
            frame(panel, window)
        clock(picture)
        canvas.draw()
        if picture == 0:
            figure.set_layout_engine("none")  # the same for all pictures
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
        for artist in drawn:
            artist.remove()


def _stage(film: _Film) -> tuple[View, Window]:
    """One view and window for all that is shown."""

    def shapes(most: int) -> Iterator[np.ndarray]:
        for run, numbers in zip(film.runs.values(), film.numbers, strict=True):
            for number in np.unique(np.linspace(0, len(numbers) - 1, most).round().astype(int)):
                u = np.asarray(run.frame(numbers[number]).displacements)
                yield whole(run.scene, u, np.zeros((run.scene.mesh.n_elements, 3))).points

    first = next(iter(film.runs.values())).scene
    triangles = whole(first, np.zeros((first.mesh.n_nodes, 3)), np.zeros((first.mesh.n_elements, 3))).triangles
    view = chosen_view(list(shapes(_MOST_VIEWED))[:_MOST_VIEWED], triangles)
    bounds = []
    for points in shapes(len(film.times)):
        projected = view.project(points)
        bounds.append(np.stack([projected.min(axis=0), projected.max(axis=0)]))
    return view, window_of(bounds)


def _usual_size(window: Window, runs: int) -> tuple[int, int]:
    aspect = window.size[1] / window.size[0]
    inches = float(np.clip(0.85 * WIDTH / runs * aspect, 1.2, 6.0)) + 1.2
    return _PIXELS, 2 * round(_PIXELS / WIDTH * inches / 2)


def _furnish(figure: Figure, panels: np.ndarray, film: _Film, coloured: Colouring, view: View, window: Window):
    """Draw all that stays; returns what sets the time to that of a picture."""
    names, first = list(film.runs), next(iter(film.runs.values()))
    for name, panel in zip(names, panels, strict=True):
        frame(panel, window)
        if len(names) > 1:
            panel.set_title(name)
    scale_bar(panels[0], window, *length_unit(first.scene))
    triad(panels[0], view)
    bar = figure.colorbar(coloured.colours, ax=panels.tolist(), fraction=0.03, aspect=30, pad=0.02)
    bar.set_label(coloured.label)
    bar.outline.set_visible(False)
    head = title(first.scene, names[0] if len(names) == 1 else "", "deformed shapes, true to scale")
    seconds, unit = scaled(first.scene, float(film.times[-1]), "s")
    step = float(film.times[1] - film.times[0]) / seconds
    decimals = max(0, min(6, math.ceil(-math.log10(step)) + 1)) if step > 0 else 0
    symbol = "λ" if first.analysis == "static" else "t"

    def clock(picture: int) -> None:
        figure.suptitle(f"{head}\n{symbol} = {film.times[picture] / seconds:.{decimals}f}{unit[3:]}", fontsize=9.5)

    clock(0)
    return clock


def _write_gif(path: Path, pictures: Iterator[np.ndarray], fps: float) -> None:
    from PIL import Image

    images = (Image.fromarray(picture).quantize(256) for picture in pictures)
    first = next(images)
    first.save(path, save_all=True, append_images=images, duration=max(20, round(1000 / fps)), loop=0, disposal=2)


def _writer_of_mp4():
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ImportError("MP4 films need imageio-ffmpeg: pip install imageio-ffmpeg. A .gif needs nothing.") from None
    # Not its write_frames, which forks: JAX warns that its threads may hang then.
    program = imageio_ffmpeg.get_ffmpeg_exe()

    def write(path: Path, pictures: Iterator[np.ndarray], fps: float) -> None:
        first = next(pictures)
        size = f"{first.shape[1]}x{first.shape[0]}"
        read = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", f"{fps:g}", "-i", "-"]
        encode = ["-an", "-vcodec", "libx264", "-crf", "18", "-pix_fmt", "yuv420p"]
        command = [program, "-y", "-v", "error", *read, *encode, str(path.absolute())]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as film:
            assert film.stdin is not None and film.stderr is not None
            with contextlib.suppress(BrokenPipeError):  # ffmpeg has said why
                for picture in itertools.chain([first], pictures):
                    film.stdin.write(np.ascontiguousarray(picture))
                film.stdin.close()
            said = film.stderr.read().decode(errors="replace").strip()
        if film.returncode:
            raise OSError(f"Cannot write {path}: {said or 'ffmpeg failed'}")

    return write
