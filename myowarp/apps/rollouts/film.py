"""Films of worlds: what they looked like step by step, kept while they move and drawn afterwards.

film = Film(sim, worlds=[0, 3])
run(sim, act, 100, film)
write(Path("run.mp4"), [film])
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from myowarp.apps.rollouts.run import Step, Watcher
from myowarp.definitions.body import BODIES
from myowarp.progress import progress_bar
from myowarp.view.drawing.captions import Captions
from myowarp.view.drawing.render import tiled
from myowarp.view.drawing.snapshot import Snapshot
from myowarp.view.drawing.video import PICTURES, VIDEOS, write_picture, write_video
from myowarp.view.pictures import Pictures

if TYPE_CHECKING:
    from myowarp.sim.simulation import Simulation
    from myowarp.view.browser.playback import Take

PLAYBACKS = (".viser", ".html")
"""Endings of films that the reader turns while they play; they need no OpenGL."""
SUFFIXES = (*VIDEOS, *PICTURES, *PLAYBACKS)
"""Endings of what `write` makes; a picture is the last frame."""


class Film(Watcher):
    """Snapshots of some worlds of a simulation, a row a step.

    Attributes:
        sim: The simulation.
        worlds: Numbers of the worlds.
        frames: What each world looked like, by step.
        captions: Lines of text on each world's picture, by step.
        color: What the colour of a muscle shows.
    """

    def __init__(
        self,
        sim: Simulation,
        worlds: Sequence[int],
        size: tuple[int, int] = (480, 360),
        camera: str | None = None,
        color: str = "activation",
        legend: bool = False,
        title: str = "",
    ) -> None:
        """Remember what to film; before the simulation is reset.

        Args:
            sim: The simulation.
            worlds: Numbers of the worlds.
            size: Width and height of one world's picture [px].
            camera: As for `Pictures`.
            color: As for `Pictures`.
            legend: As for `Pictures`.
            title: First line on every picture.

        Raises:
            ValueError: The size or the colour is wrong.
        """
        self.sim, self.worlds = sim, list(worlds)
        self.frames: list[list[Snapshot]] = []
        self.captions: list[list[list[str]]] = []
        self.color = color
        self._legend = legend
        self._pictures = Pictures(size, camera, color, legend)
        self._pictures.attach(sim)
        self._text = Captions(self.worlds, sim.scene.control_dt, title)

    def add(
        self,
        reward: np.ndarray | None = None,
        success: np.ndarray | None = None,
        seen: Sequence[Snapshot] | None = None,
    ) -> None:
        """Keep what the worlds look like now.

        Args:
            reward: Rewards of the step that led here, shape (num_worlds,); None right after a reset.
            success: Whether the task counts as solved, shape (num_worlds,).
            seen: What the worlds look like, where it is known already.
        """
        if reward is not None:
            self._text.add(reward, success)
        self.frames.append(list(seen or (self._pictures.snapshot(self.sim, world) for world in self.worlds)))
        if len(self.frames) == 2:  # conditions weaken muscles in a step, not in a reset
            self.frames[0] = [_as_strong(*pair) for pair in zip(*self.frames, strict=True)]
        self.captions.append(self._text.lines())

    def begin(self, ended: np.ndarray) -> None:
        """Start time and return anew in the worlds of a mask (num_worlds,) bool, whose episodes ended."""
        self._text.begin(ended)

    def start(self, mask: np.ndarray) -> None:
        """Keep how the worlds begin; later, only start time and return anew."""
        if self.frames:
            self.begin(mask)
        else:
            self.add()

    def see(self, step: Step) -> None:
        """Keep what the worlds look like after a step."""
        self.add(step.reward, step.success)

    def marks(self) -> str:
        """Return what balls and shadows in the pictures are, in a sentence; "" where there are none."""
        seen = self.frames[-1][0]
        meanings = {
            "green balls are targets": bool(seen.goals),
            "orange balls are the tips of the limb": bool(BODIES[self.sim.scene.spec.body].tips),
            "a green shadow is the wanted posture": seen.ghost is not None,
        }
        words = [words for words, shown in meanings.items() if shown]
        return f"In the film {', '.join(words)}" if words else ""

    def open(self) -> None:
        """Open what draws, so that it fails before anything is simulated.

        Raises:
            ValueError: The model has no such camera.
            myowarp.view.drawing.render.NoGraphicsError: No OpenGL was found.
        """
        self._pictures.renderer(self.sim)

    def close(self) -> None:
        """Free what draws."""
        self._pictures.close()

    def tiles(self) -> Iterator[list[np.ndarray]]:
        """Yield the pictures of all worlds, step by step.

        Raises:
            myowarp.view.drawing.render.NoGraphicsError: No OpenGL was found.
        """
        renderer = self._pictures.renderer(self.sim)
        renderer.fit(seen for row in self.frames for seen in row)
        for row, captions in zip(self.frames, self.captions, strict=True):
            yield [
                renderer.frame(seen, lines, self._legend and not index)  # one legend is enough
                for index, (seen, lines) in enumerate(zip(row, captions, strict=True))
            ]

    def takes(self) -> list[Take]:
        """Return what each world looked like, for `myowarp.view.browser.playback`."""
        from myowarp.view.browser.playback import Take

        tips = BODIES[self.sim.scene.spec.body].tips
        shown = zip(zip(*self.frames, strict=True), zip(*self.captions, strict=True), strict=True)
        return [Take(self.sim.full_model, tips, frames, captions) for frames, captions in shown]


def _as_strong(seen: Snapshot, after: Snapshot) -> Snapshot:
    """Return a snapshot with the strength of the muscles that another one shows."""
    strength = {name: after.muscles[name] for name in ("strength",) if name in after.muscles}
    return seen._replace(muscles={**seen.muscles, **strength})


def write(
    path: Path, films: Sequence[Film], console: Console | None = None, fps: float | None = None
) -> None:
    """Draw films and write them, side by side if there are several; the frames are those of equal steps.

    Args:
        path: File to write, ending in .mp4, .gif, .viser, .html, or .png for the last frame alone.
        films: Films of the same number of steps.
        console: Where to draw the progress bar.
        fps: Frames per second; None: real time.

    Raises:
        myowarp.view.drawing.render.NoGraphicsError: No OpenGL was found.
        OSError: The file cannot be written.
    """
    rate = fps or 1.0 / films[0].sim.scene.control_dt
    if path.suffix.lower() in PLAYBACKS:
        from myowarp.view.browser.playback import write_playback

        takes = [film.takes() for film in films]
        rows = list(zip(*takes, strict=True)) if len(films) > 1 else takes
        write_playback(path, rows, films[0].color, rate)
        return
    if path.suffix.lower() in PICTURES:
        for film in films:
            film.frames, film.captions = film.frames[-1:], film.captions[-1:]
    count = len(films[0].frames)
    with progress_bar("Drawing", "frames", console) as bar:
        steps = zip(*(film.tiles() for film in films), strict=True)
        images = (_together(tiles) for tiles in bar.track(steps, total=count))
        if path.suffix.lower() in PICTURES:
            write_picture(path, next(images))
        else:
            write_video(path, images, rate)


def _together(films: tuple[list[np.ndarray], ...]) -> np.ndarray:
    """Return one image: films side by side, of each the worlds as tiles."""
    if len(films) == 1:
        count = len(films[0])
        return tiled(films[0], -(-count // 2) if count > 3 else None)
    # A row a world, a column a film: what differs stands side by side.
    return tiled([tile for row in zip(*films, strict=True) for tile in row], len(films))
