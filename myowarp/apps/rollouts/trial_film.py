"""Films of recorded motions: the trial as it moves, over traces with a line at the moment that is seen."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console

from myowarp.apps.rollouts.film import PLAYBACKS
from myowarp.progress import progress_bar
from myowarp.view.browser.chart import SHARPNESS, Chart, Curve, as_png
from myowarp.view.browser.playback import Take, write_playback
from myowarp.view.browser.traces import CURVES, TARGET_DASH, titled
from myowarp.view.browser.trial_traces import FIRST, largest
from myowarp.view.drawing.recorded import Recorded
from myowarp.view.drawing.render import WorldRenderer
from myowarp.view.drawing.video import PICTURES, write_picture, write_video

FASTEST = 60.0
"""Pictures a second, at most; of more frames some are left out."""
STRIP = 110
"""Height of the traces [px of a picture's traces that is 480 px wide]."""


def write_trial(
    path: Path,
    recorded: Recorded,
    color: str,
    size: tuple[int, int],
    fps: float | None,
    console: Console,
    most: int | None = None,
) -> None:
    """Film a recorded motion.

    Args:
        path: File to write, as of `myowarp record`; .png is the last frame.
        recorded: The motion.
        color: What colours of muscles show.
        size: Width and height of the picture, traces not included [px].
        fps: Pictures a second; None: real time.
        console: Where progress is shown.
        most: Pictures at most, from the beginning; None: all.

    Raises:
        ValueError: The colour or the size is wrong.
        myowarp.view.drawing.render.NoGraphicsError: No OpenGL was found.
        OSError: The file cannot be written.
    """
    count = len(recorded.time)
    rate = (count - 1) / float(recorded.time[-1] - recorded.time[0])
    stride = max(1, int(np.ceil(rate / FASTEST - 1e-6)))
    rate, frames = fps or rate / stride, list(range(0, count, stride))[:most]
    if path.suffix.lower() in PLAYBACKS:
        seen = [recorded.seen(frame) for frame in frames]
        take = Take(recorded.model, (), seen, [[f"{recorded.time[frame]:.2f} s"] for frame in frames])
        write_playback(path, [[take]], color, rate)
        return
    picture = path.suffix.lower() in PICTURES
    frames = frames[-1:] if picture else frames
    with WorldRenderer(recorded.model, *size, color=color, legend=True) as renderer:
        renderer.framing.look_along(recorded.across)
        renderer.fit(recorded.seen(frame) for frame in frames)

        def pictures() -> Iterator[np.ndarray]:
            for frame in frames:
                time = float(recorded.time[frame])
                above = renderer.frame(recorded.seen(frame), [f"{time:.2f} s"])
                yield np.concatenate((above, strip(recorded, time, size[0])))

        if picture:
            write_picture(path, next(pictures()))
            return
        with progress_bar("Drawing", "frames", console) as bar:
            write_video(path, bar.track(pictures(), total=len(frames)), rate)


def strip(recorded: Recorded, now: float, width: int) -> np.ndarray:
    """Return the traces below a picture, uint8, shape (height, width, 3).

    Args:
        recorded: The motion.
        now: Time that is marked [s].
        width: Of the picture [px].
    """
    charts = []
    for kind, number in FIRST.items():
        if (course := recorded.courses.get(kind)) is None:
            continue
        curves = []
        for ink, k in zip(CURVES, largest(recorded, kind)[:number], strict=False):
            curves.append(Curve(course.items[k], course.values[:, k], ink))
            if course.measured is not None and np.isfinite(course.measured[:, k]).any():
                curves.append(Curve(f"{course.items[k]} EMG", course.measured[:, k], ink, TARGET_DASH))
        charts.append(Chart(titled(kind, course.unit), recorded.time, curves, now=now))
    drawn = Image.open(io.BytesIO(as_png(charts, SHARPNESS * 480, SHARPNESS * STRIP)))
    height = round(STRIP / 480 * width)
    return np.asarray(drawn.resize((width, height), Image.Resampling.LANCZOS))
