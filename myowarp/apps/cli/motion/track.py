"""The step `myowarp motion track`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from rich.console import Console

from myowarp.apps.cli.motion.steps import (
    OUT,
    SHOWN,
    Contact,
    Filter,
    FunctionPaths,
    Loading,
    Model,
    Output,
    Recorded,
    Reserve,
    Residual,
    Span,
    ToolFile,
    absent_from,
    bones_of,
    check_results,
    needed,
    say_saved,
    setup_of,
)
from myowarp.apps.cli.options import Overwrite, optional
from myowarp.disk import make_folder
from myowarp.progress import progress_bar

if TYPE_CHECKING:
    from myowarp.motion.tracking import Tracked
    from myowarp.osim.body.skeleton import Bones

FILES = (
    "tracked.mot",
    *(f"{name}.sto" for name in ("excitations", "activations", "fiber_lengths", "forces", "reserves")),
)


@dataclass
class Track:
    """Find excitations that make a simulation follow a motion under its loads, by computed muscle control.

    The last lines say how much --reserve, and --residual at the root, had to add.

    Example: myowarp motion track gait.osim --motion ik.mot --loads grf.xml --reserve 1 --strength
    soleus_r=0.9
    """

    model: Model
    motion: Recorded = None
    setup: ToolFile = None
    function_paths: FunctionPaths = None
    loads: Loading = None
    contact: Contact = None
    filter: Filter = None
    reserve: Reserve = None
    residual: Residual = None
    strength: Annotated[tuple[str, ...], optional("[MUSCLE=FACTOR ...]")] = ()
    """Factors on maximum isometric forces of muscles, such as soleus_r=0.9."""
    gain: Annotated[tuple[str, ...], optional("[COORDINATE=GAIN ...]")] = ()
    """Ways back to the motion [1/s^2] of coordinates, such as mtp_angle_r=1600, in place of 100, or 1600
    where bodies are light."""
    span: Span = None
    output: Output = OUT
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, simulate, write."""
        from myowarp.motion import trial
        from myowarp.motion.tracking import WINDOW

        factors = numbers_of("strength", self.strength, "soleus_r=0.9")
        gains = numbers_of("gain", self.gain, "mtp_angle_r=1600")
        setup = setup_of(
            self.setup, motion=self.motion, contact=self.contact, loads=self.loads, cutoff=self.filter,
            span=self.span,
            reserve=self.reserve, residual=self.residual,
        )  # fmt: skip
        recorded = needed(setup.motion, "track", "motion")
        check_results(self.output, FILES, self.overwrite)
        bones = bones_of(self.model, setup, self.function_paths)
        motion = trial.read_motion(recorded, bones, setup.cutoff)
        make_folder(self.output)
        ends = zip(setup.span or (-np.inf, np.inf), motion.time[[0, -1]], strict=True)
        begin, end = (edge if np.isinf(x) else x for x, edge in ends)
        with progress_bar("Tracking", "windows", Console(stderr=True)) as bar:
            task = bar.add_task("", total=max(1, round((end - begin) / WINDOW)))
            found = trial.follow(
                bones, motion, self.output, setup.loads, reserves=setup.reserves_of(bones), factors=factors,
                gains={**setup.gains, **gains}, controls=setup.controls, span=(begin, end),
                advance=lambda count: bar.advance(task, count),
            )  # fmt: skip
        say_saved([*absent_from(motion), *_lines(bones, found)], FILES, self.output)


def numbers_of(option: str, words: tuple[str, ...], example: str) -> dict[str, float]:
    """Return what an option says, by name.

    Raises:
        ValueError: A word is not like the example.
    """
    found = {}
    for word in words:
        name, _, number = word.partition("=")
        try:
            found[name] = float(number)
        except ValueError:
            raise ValueError(f"--{option} must be like {example}, got {word!r}") from None
    return found


def _lines(bones: Bones, found: Tracked) -> list[str]:
    """Return how far off the simulation is, and what reserves give, one line each."""
    lines, off = [], found.off()[0]
    turns = [bones.model.coordinates[name].rotational for name in bones.coordinates]
    shown = np.where(turns, np.degrees(off), 100.0 * off)  # a degree beside a centimetre
    for k in shown.argsort()[::-1][:SHOWN]:
        unit = "°" if turns[k] else "cm"
        lines.append(f"{bones.coordinates[k]}: {shown[k]:.2f} {unit} rms off the motion")
    most = abs(found.reserve[:, 0]).max(axis=0)
    for k in most.argsort()[::-1][:SHOWN]:
        lines.append(f"reserve at {bones.coordinates[k]}: {most[k]:.3g} {'N m' if turns[k] else 'N'} at most")
    return lines
