"""The command `myowarp record`: a film of a policy in some worlds, or of two patients side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from rich.console import Console

from myowarp.apps.cli.options import (
    Conditions,
    Device,
    Model,
    OptionalTask,
    Overwrite,
    Physics,
    Policy,
    Reset,
    Steps,
    optional,
)
from myowarp.definitions.registry import check_least
from myowarp.view.drawing.muscles import QUANTITIES

if TYPE_CHECKING:
    from collections.abc import Callable

    from myowarp.apps.rollouts.film import Film
    from myowarp.bridge_gym import MyoWarpVectorEnv


@dataclass
class Record:
    """Film a policy: several worlds as tiles, or two sets of conditions side by side from the same state.

    Muscles are as wide as they are strong, and coloured by what they do. A green ghost shows the posture that
    a pose task asks for; lines join tips to their targets.

    Example: myowarp record myoHandReachRandom-v1 --worlds 4 -o hand.gif

    A healthy elbow beside a weak one:
    myowarp record myoElbowPose1D6MRandom-v0 --policy hold --beside sarcopenia
    """

    task: OptionalTask = None
    model: Model = None
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/film.mp4")
    """File to write: .mp4, .gif, .png for the last frame alone, .html for a page where the reader turns the
    bodies, or .viser for what that page plays."""
    policy: Policy = "random"
    worlds: int = 1
    """Worlds, as tiles."""
    steps: Steps = None
    seed: int = 0
    """Seed of resets and of the random policy."""
    conditions: Conditions = ()
    beside: Annotated[tuple[str, ...], optional("[NAME ...]")] = ()
    """Film the same worlds with these conditions, too, side by side; "none" for no condition."""
    reset: Reset = None
    physics: Physics = "parity"
    device: Device = None
    color: Annotated[str, tyro.conf.arg(metavar="{" + ",".join(QUANTITIES) + "}")] = "activation"
    """What the colour of a muscle shows."""
    camera: Annotated[str | None, optional("NAME")] = None
    """Camera of the model; by default one that frames the limb, tips, targets and objects."""
    size: tuple[int, int] = (480, 360)
    """Width and height of one world's picture [px]."""
    fps: Annotated[float | None, optional("FLOAT")] = None
    """Frames per second; by default real time."""
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, run, draw."""
        from myowarp.apps.rollouts.film import PLAYBACKS, SUFFIXES, Film, write
        from myowarp.apps.rollouts.rollout import acting, find_policy
        from myowarp.bridge_gym import MyoWarpVectorEnv
        from myowarp.definitions.condition import resolve
        from myowarp.definitions.task import TASKS
        from myowarp.disk import check_folder, check_output, check_overwrite
        from myowarp.tasks.from_file import task_or_model
        from myowarp.view.drawing.render import check_size
        from myowarp.view.modes import check_viser

        variant = task_or_model(self.task, self.model)
        spec = TASKS[variant.task]
        steps = spec.horizon if self.steps is None else self.steps
        check_least(1, steps=steps, worlds=self.worlds)
        check_least(0, seed=self.seed)
        if self.fps is not None and not 0.0 < self.fps < np.inf:
            raise ValueError(f"--fps must be positive, got {self.fps:g}")
        check_size(*self.size)
        changed = () if self.beside == ("none",) else self.beside
        for names in (self.conditions, changed):
            resolve((*variant.conditions, *names), spec)
        policy = find_policy(self.policy, spec)
        turned = self.output.suffix.lower() in PLAYBACKS
        if turned:
            check_viser(f"output {str(self.output)!r}")
            if self.camera is not None:
                raise ValueError(f"output {str(self.output)!r} is turned by its reader; leave out --camera")
        check_folder(self.output.parent)
        self.output.parent.mkdir(parents=True, exist_ok=True)
        check_output(self.output, *SUFFIXES)
        check_overwrite((self.output,), self.overwrite)
        own = (*variant.conditions, *self.conditions)
        sets = [own, (*variant.conditions, *changed)] if self.beside else [own]
        options: dict[str, Any] = {"device": self.device, "physics": self.physics}
        options |= {"reset": self.reset or variant.reset, "autoreset_mode": "disabled"}
        envs = [MyoWarpVectorEnv(spec.key, self.worlds, conditions=names, **options) for names in sets]
        look: dict[str, Any] = {"size": self.size, "camera": self.camera, "color": self.color, "legend": True}
        titles = [", ".join(names) or "healthy" for names in sets] if self.beside else [""]
        films = [
            Film(env.sim, range(self.worlds), title=title, **look)
            for env, title in zip(envs, titles, strict=True)
        ]
        for film in films:
            if not turned:
                film.open()
        acts = [acting(policy, env.sim, self.seed) for env in envs]
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        film_worlds(envs, films, acts, steps, self.seed, console)
        write(self.output, films, console, self.fps)
        console.print(f"Saved {self.output}")
        for film, env in zip(films, envs, strict=True):
            film.close()
            env.close()


def film_worlds(
    envs: list[MyoWarpVectorEnv],
    films: list[Film],
    acts: list[Callable[[np.ndarray], np.ndarray]],
    steps: int,
    seed: int,
    console: Console | None = None,
) -> None:
    """Run environments side by side, each world from the same state in all, and film them.

    A world that ends in one environment starts its next episode in all of them, again from the same state.

    Args:
        envs: Environments of one task, without autoreset, that differ in their conditions.
        films: A film of each.
        acts: What acts in each.
        steps: Control steps.
        seed: Seed of the resets.
        console: Where to draw the progress bar.
    """
    from myowarp.progress import progress_bar

    first, *others = envs
    seeds: int | None = seed

    def start(mask: np.ndarray) -> list[np.ndarray]:
        """Reset the worlds of a mask in all environments; return what each observes."""
        found = [env.reset(seed=seeds, options={"reset_mask": mask})[0] for env in envs]
        for index, env in enumerate(others, start=1):
            found[index] = env.set_state(first.get_state(mask), mask, conditions=False)
        return found

    observations = start(np.ones(first.num_envs, dtype=bool))
    seeds = None
    for film in films:
        film.add()
    with progress_bar("Simulating", "steps", console) as bar:
        for step in bar.track(range(1, steps + 1)):
            ended = np.zeros(first.num_envs, dtype=bool)
            for index, (env, film, act) in enumerate(zip(envs, films, acts, strict=True)):
                observations[index], reward, terminated, truncated, info = env.step(act(observations[index]))
                film.add(reward, info["success"])
                ended |= terminated | truncated
            if ended.any() and step < steps:
                observations = start(ended)
                for film in films:
                    film.begin(ended)
