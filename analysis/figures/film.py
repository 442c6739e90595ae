"""A film of the closed loop, before tuning beside after it."""

import shutil
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from zoac.analysis.data import cli, replay
from zoac.analysis.data.runs import Run
from zoac.analysis.figures import style
from zoac.core.errors import ConfigError, RunFolderError, suggest
from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.rollout.task import Task

FRAMES, PER_SECOND = 120, 12
HOLD = 12
"""Frames for which the end stands still."""
SIZE, DPI = (8.0, 3.6), 100
LOOKS = (style.BEFORE, style.AFTER)


def write(path: Path, run: Run) -> None:
    """Write a film of the demonstration episode as .gif or, where ffmpeg is installed, .mp4.

    Raises:
        ConfigError: If the suffix is another one, ffmpeg is needed and missing, or the file
            cannot be written.
        RunFolderError: If the run did not log the parameters it began with.
    """
    kinds = (".gif", ".mp4")
    if path.suffix not in kinds:
        raise ConfigError(f"cannot write a film as {path.suffix!r}; {suggest(path.suffix, kinds)}")
    if path.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise ConfigError("writing .mp4 needs ffmpeg, which was not found; write .gif instead")
    if run.start is None:
        raise RunFolderError(
            f"{run.folder}: no evaluation at step 0, so there is no 'before tuning' to show"
        )
    task = replay.rebuild(run)
    segments = replay.demonstrate(task, [run.start, run.outcome["parameters"]])
    titles = ("Before tuning", f"After {run.outcome['env_steps']:,} steps")
    with cli.writing(path), style.drawing(style.SCREEN):
        (_write_gif if path.suffix == ".gif" else _write_mp4)(path, frames(task, segments, titles))


def frames(task: Task, segments: Sequence[Segment], titles: Sequence[str]) -> Iterator[np.ndarray]:
    """Yield pictures (height, width, 3) uint8 of the segments side by side, over one plot of both.

    The plot shows both courses from the first picture on, so that the difference is seen at once.
    The film ends where the last segment has settled.
    """
    last = replay.settled(task, segments[-1:])
    shown = [_shown(task, segment) for segment in segments]
    longest = max(shown, key=lambda trace: len(trace.x))
    ordinates = np.concatenate([trace.y[: last + 1] for trace in shown])
    margin = 0.06 * max(np.ptp(ordinates), 1e-9)
    steps = np.unique(np.linspace(0, last, FRAMES).round().astype(int)).tolist()
    for step in [*steps, *[last] * HOLD]:
        figure = Figure(figsize=SIZE, dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        plot = figure.add_axes((0.085, 0.125, 0.895, 0.245))
        for k, (segment, trace, title) in enumerate(zip(segments, shown, titles, strict=True)):
            left, look = k / len(segments), LOOKS[k % len(LOOKS)]
            width, here = 1 / len(segments), min(step, segment.length)
            scene = figure.add_axes((left + 0.01, 0.405, width - 0.02, 0.485))
            if not task.draw(scene, segment, here):
                scene.set_axis_off()
            cost = f"cost {segment.costs.sum():,.1f}"
            figure.text(left + 0.02, 0.93, title, color=look.colour, size=11, weight="bold")
            figure.text(left + width - 0.02, 0.93, cost, color=look.colour, size=10, ha="right")
            line = {"color": look.colour, "linestyle": look.dashes}
            plot.plot(trace.x[: last + 1], trace.y[: last + 1], linewidth=1.0, alpha=0.35, **line)
            plot.plot(trace.x[: here + 1], trace.y[: here + 1], linewidth=1.8, **line)
            plot.plot(
                trace.x[here : here + 1], trace.y[here : here + 1], "o", color=look.colour, ms=5
            )
            if segment.terminated and step >= segment.length:
                plot.plot(trace.x[-1], trace.y[-1], "x", color=look.colour, markersize=9)
                figure.text(left + 0.02, 0.875, "episode ended: error too large", color=look.colour,
                            size=9)  # fmt: skip
        plot.set_xlim(longest.x[0], longest.x[min(last, len(longest.x) - 1)])
        plot.set_ylim(ordinates.min() - margin, ordinates.max() + margin)
        plot.set_xlabel(longest.x_label, labelpad=1)
        plot.set_ylabel(longest.title)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _shown(task: Task, segment: Segment) -> Trace:
    """Return the trace below the picture: the first that is an error, not a line to follow."""
    traces = task.traces(segment)
    return next((trace for trace in traces if trace.reference is None), traces[0])


def _write_gif(path: Path, pictures: Iterable[np.ndarray]) -> None:
    images = [Image.fromarray(picture) for picture in pictures]
    # One palette for all, from the busiest picture: colours must not flicker.
    palette = images[-1].quantize(64, dither=Image.Dither.NONE)
    first, *rest = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    first.save(
        path, save_all=True, append_images=rest, duration=1000 // PER_SECOND, loop=0, optimize=True
    )


def _write_mp4(path: Path, pictures: Iterable[np.ndarray]) -> None:
    width, height = (round(inches * DPI) for inches in SIZE)
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    target = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-fflags", "+bitexact", str(path)]
    command = ["ffmpeg", "-y", "-loglevel", "error", *source, "-r", str(PER_SECOND), "-i", "-"]
    done = subprocess.run(
        [*command, *target], input=b"".join(p.tobytes() for p in pictures), capture_output=True
    )
    if done.returncode:
        raise ConfigError(f"ffmpeg could not write {path}: {done.stderr.decode().strip()}")
