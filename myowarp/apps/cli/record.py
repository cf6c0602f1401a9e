"""The command `myowarp record`: a film of a policy in some worlds, or of two patients side by side."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console

from myowarp.apps.cli.options import Environment, Overwrite, Policy, Recording, Steps, Trial, optional
from myowarp.definitions.registry import check_least
from myowarp.view.drawing.muscles import QUANTITIES

LONGEST = 32  # characters of a title


@dataclass
class Record:
    """Film a policy: several worlds as tiles, or two policies or sets of conditions side by side.

    Muscles are as wide as they are strong, and coloured by what they do. Targets are green, balls and a ghost
    in the posture of a pose task; tips of the limb are orange, and lines join them to their targets.

    Example: myowarp record myoHandReachRandom-v1 --worlds 4 -o hand.gif

    A healthy elbow beside a weak one:
    myowarp record myoElbowPose1D6MRandom-v0 --policy hold --beside sarcopenia

    A policy beside another, in the same patient:
    myowarp record myoElbowPose1D6MRandom-v0 --policy hold --beside-policy baseline

    A recorded motion over traces of its muscle forces:
    myowarp record --model gait.osim --motion out/trial --loads grf.xml
    """

    asked: Environment
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/film.mp4")
    """File to write: .mp4, .gif, .png for the last frame alone, .html for a page where the reader turns the
    bodies, or .viser for what that page plays."""
    policy: Policy = "random"
    worlds: int = 1
    """Worlds, as tiles."""
    steps: Steps = None
    beside: Annotated[tuple[str, ...], optional("[NAME ...]")] = ()
    """Film the same worlds with these conditions, too, side by side, from the same state; "none" for no
    condition."""
    beside_policy: Annotated[str | None, optional("NAME")] = None
    """Film the same worlds under this policy, too, side by side, from the same state, the same patients."""
    color: Annotated[str | None, tyro.conf.arg(metavar="{" + ",".join(QUANTITIES) + "}")] = None
    """Quantity that colours muscles; by default activation, of a recorded motion force."""
    camera: Annotated[str | None, optional("NAME")] = None
    """Camera of the model; by default one that frames the limb, tips, targets and objects."""
    size: tuple[int, int] = (480, 360)
    """Width and height of one world's picture [px]."""
    fps: Annotated[float | None, optional("FLOAT")] = None
    """Frames per second; by default real time."""
    overwrite: Overwrite = False
    recording: Recording = dataclasses.field(default_factory=Trial)

    def __call__(self) -> None:
        """Check, run, draw."""
        from myowarp.apps.policies.find import acting, find_policy
        from myowarp.apps.rollouts.beside import Beside
        from myowarp.apps.rollouts.film import Film, write
        from myowarp.apps.rollouts.run import Watcher, progress, run
        from myowarp.sim.simulation import Simulation
        from myowarp.tasks.setups import complete

        if (source := self.recording.source(self.asked)) is not None:
            return self._film(source)
        asked = self.asked.setup
        if self.beside and self.beside_policy is not None:
            raise ValueError("--beside and --beside-policy are two comparisons; leave one of them out")
        setups, names = [complete(asked)], [self.policy]
        own = setups[0]
        if self.beside:
            changed = () if self.beside == ("none",) else self.beside
            setups.append(complete(dataclasses.replace(asked, conditions=changed)))
            names.append(self.policy)
        elif self.beside_policy is not None:
            setups.append(own)
            names.append(self.beside_policy)
        steps = own.episode_steps if self.steps is None else self.steps
        check_least(1, steps=steps, worlds=self.worlds)
        self._check_picture()
        policies = [find_policy(name, own.spec) for name in names]
        turned = self._check_output()
        sims = [Simulation(setup, self.worlds, autoreset="disabled") for setup in setups]
        look: dict[str, Any] = {
            "size": self.size,
            "camera": self.camera,
            "color": self.color or "activation",
            "legend": True,
        }
        films = []
        titles = [", ".join(setup.plain()["conditions"]) or "healthy" for setup in setups]
        titles = titles if self.beside else told_apart(names) if len(sims) > 1 else [""]
        for sim, title in zip(sims, titles, strict=True):
            films.append(Film(sim, range(self.worlds), title=title, **look))
        for film in films:
            if not turned:
                film.open()
        acts = [acting(policy, sim) for policy, sim in zip(policies, sims, strict=True)]
        watchers: list[Watcher] = [films[0]]
        if len(sims) > 1:
            watchers.append(Beside(sims[0], sims[1], acts[1], films[1], patients=not self.beside))
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        with progress("Simulating", "steps", steps, console) as bar:
            run(sims[0], acts[0], steps, *watchers, bar)
        write(self.output, films, console, self.fps)
        console.print(f"Saved {self.output}")
        if text := films[0].marks():
            console.print(text)
        for film, sim in zip(films, sims, strict=True):
            film.close()
            sim.close()

    def _check_picture(self) -> None:
        """Raise ValueError if pictures cannot be as they are asked for."""
        from myowarp.view.drawing.render import check_size

        if self.fps is not None and not 0.0 < self.fps < np.inf:
            raise ValueError(f"--fps must be positive, got {self.fps:g}")
        check_size(*self.size)

    def _check_output(self) -> bool:
        """Make the folder of the film; say whether its reader turns it.

        Raises:
            ValueError: It cannot be written, or is there.
        """
        from myowarp.apps.rollouts.film import PLAYBACKS, SUFFIXES
        from myowarp.disk import check_folder, check_output, check_overwrite, make_folder
        from myowarp.view.modes import check_viser

        turned = self.output.suffix.lower() in PLAYBACKS
        if turned:
            check_viser(f"output {str(self.output)!r}")
            if self.camera is not None:
                raise ValueError(f"output {str(self.output)!r} is turned by its reader; leave out --camera")
        check_folder(self.output.parent)
        make_folder(self.output.parent)
        check_output(self.output, *SUFFIXES)
        check_overwrite((self.output,), self.overwrite)
        return turned

    def _film(self, source: Path) -> None:
        """Film a recorded motion."""
        from myowarp.view.drawing.recorded import Recorded
        from myowarp.view.modes import check_viser

        trial = self.recording
        assert trial.motion is not None
        wrong = {
            "worlds": self.worlds != 1,
            "beside": self.beside,
            "beside-policy": self.beside_policy is not None,
            "camera": self.camera,
        }
        for name, given in wrong.items():
            if given:
                raise ValueError(f"--{name} belongs to a policy that acts; leave it out beside --motion")
        check_viser("a film of a recorded motion")
        from myowarp.apps.rollouts.trial_film import write_trial

        if self.steps is not None:
            check_least(1, steps=self.steps)
        self._check_picture()
        self._check_output()
        recorded = Recorded(source, trial.motion, trial.results, trial.loads)
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        write_trial(
            self.output, recorded, self.color or recorded.colored, self.size, self.fps, console, self.steps
        )
        console.print(f"Saved {self.output}")


def told_apart(names: list[str]) -> list[str]:
    """Return names of policies as a picture has room for: without common folders, the ends of long ones."""
    parts = [Path(name).parts for name in names]
    if len({len(own) for own in parts}) > 1:
        return [name if len(name) <= LONGEST else f"...{name[-LONGEST:]}" for name in names]
    differ = [len(set(level)) > 1 for level in zip(*parts, strict=True)]
    return ["/".join(compress(own, differ)) or name for name, own in zip(names, parts, strict=True)]
