"""The step `myowarp motion track`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.said import of_tracking
from myowarp.apps.cli.motion.steps import absent_from, bones_of, check_results, needed, say_saved, setup_of
from myowarp.apps.cli.options import optional
from myowarp.definitions.parameter import say_percent
from myowarp.progress import patient_bar

FILES = (
    "tracked.mot",
    *(f"{name}.sto" for name in ("excitations", "activations", "fiber_lengths", "forces", "reserves")),
)


@dataclass
class Track(of.Along):
    """Find excitations that make a simulation follow a motion under its loads, by computed muscle control.

    The last lines say how much --reserve, and --residual at the root, had to add.

    Example: myowarp motion track gait.osim --motion ik.mot --loads grf.xml --reserve 1 --strength
    soleus_r=0.9
    """

    loads: of.Loads = None
    reserve: of.Reserve = None
    residual: of.Residual = None
    strength: Annotated[tuple[str, ...], optional("[MUSCLE=FACTOR ...]")] = ()
    """Factors on maximum isometric forces of muscles, such as soleus_r=0.9."""
    gain: Annotated[tuple[str, ...], optional("[COORDINATE=GAIN ...]")] = ()
    """Ways back to the motion [1/s^2] of coordinates, such as mtp_angle_r=1600, in place of 100, or 1600
    where bodies are light."""

    def __call__(self) -> None:
        """Check, simulate, write."""
        from myowarp.motion import steps
        from myowarp.motion.tracking import WINDOW

        factors = numbers_of("strength", self.strength, "soleus_r=0.9")
        for muscle, factor in factors.items():
            say_percent(f"the strength {muscle}", factor)
        gains = numbers_of("gain", self.gain, "mtp_angle_r=1600")
        setup = setup_of(self, strength=factors)
        setup = setup.stating(gains={**setup.gains, **gains})
        needed(setup.motion, "track", "motion")
        check = check_results(self.output, FILES, self.overwrite)
        bones = bones_of(self, setup)
        motion = steps.moved(bones, setup.whole)
        begin, end = setup.within(motion.time)
        with patient_bar(
            "Tracking", "windows", max(1, round((end - begin) / WINDOW)), patience=0.0
        ) as advance:
            found = steps.track(bones, setup, motion, advance)
        check()
        found.write(self.output)
        say_saved([*absent_from(motion), *of_tracking(found)], FILES, self.output)


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
