"""The command `myowarp score`: how human a walk is."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.table import Column

from myowarp.apps.cli.options import Environment, Overwrite, Policy, optional
from myowarp.definitions.registry import check_least
from myowarp.extras import check_installed

if TYPE_CHECKING:
    from myowarp.apps.reports.walk_measures import Measured

FILES = ("score.json", "score.html", "score.png")
SETTLED = 1.0
"""Time of a policy before which no stride counts [s]: it begins in a pose that nobody walks through."""


@dataclass
class Score:
    """Score how human a walk is, of a policy of legs or of a recorded trial: a table, JSON, and a page.

    Joint angles, moments, forces of the ground and activations over the gait cycle, steps, metabolic price
    and balance are set beside a person's, with normalised errors and 95 % intervals, the worst first.

    Example: myowarp score myoLegWalk-v0 --policy baseline

    Of a trial, a folder of `myowarp motion`, whose model --model names:
    myowarp score --trial out/walk --model person.osim --loads grf.xml
    """

    asked: Environment
    policy: Policy = "baseline"
    num_worlds: int = 16
    """Worlds, of which each walks for one episode."""
    trial: Annotated[Path | None, optional("FOLDER")] = None
    """In place of a policy: a folder with joint angles, and what else `myowarp motion` found; the model is
    --model or scaled.osim in it."""
    push: Annotated[float | None, optional("M/S")] = None
    """Walk once more with pushes, and count falls: every 2 s the body gets a velocity of so much in a random
    level direction."""
    loads: Annotated[Path | None, optional("FILE")] = None
    """OpenSim file with the forces of the ground on both feet; by default grf.xml in the trial's folder."""
    reference: Annotated[Path | None, optional("PATH")] = None
    """In place of the package's own reference: a trial's folder with scaled.osim and grf.xml in it, or
    score.json of another walk."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/score")
    """Folder for score.json, score.html and score.png."""
    overwrite: Overwrite = False
    json: bool = False
    """Print JSON instead of a table."""

    def __call__(self) -> None:
        """Check, walk, score, write."""
        from myowarp.apps.reports.table import terminal
        from myowarp.apps.reports.walk_measures import SHIPPED, as_reference, read_reference
        from myowarp.apps.reports.walk_page import BRIEF, brief, findings, write_page
        from myowarp.apps.reports.walk_score import as_dict, score, write_json
        from myowarp.disk import check_folder, check_overwrite, make_folder

        check_installed("score", "matplotlib", "plot")
        check_least(1, num_worlds=self.num_worlds)
        if self.push is not None and not 0.0 < self.push < float("inf"):
            raise ValueError(f"--push must be positive and finite, got {self.push:g}")
        check_folder(self.output)
        check_overwrite([self.output / name for name in FILES], self.overwrite, "folder with --output")
        given = self.reference
        if given is not None and given.is_dir():
            reference = as_reference(_of_trial(given))
        else:
            reference = read_reference(given or SHIPPED)
        head, walk = self._walked() if self.trial is None else self._recorded(self.trial)
        pushed: dict[str, Any] | None = head.get("pushed")
        falls = None if pushed is None else (int(pushed["falls"]), int(pushed["episodes"]))
        found = score(walk, reference, falls)
        said = as_dict(walk, found, reference, head)
        make_folder(self.output)
        write_json(self.output / "score.json", said)
        write_page(self.output, walk, found, reference)
        if self.json:
            print(json.dumps(said, indent=1))
            return
        console = Console(highlight=False, soft_wrap=True)
        console.print(terminal([Column(head, no_wrap=True) for head in BRIEF], map(brief, found.rows)))
        for text, bad in findings(walk, found, reference):
            console.print(text, style="yellow" if bad else None, markup=False)
        Console(stderr=True, highlight=False).print(f"Saved {', '.join(FILES)} in {self.output}")

    def _recorded(self, trial: Path) -> tuple[dict[str, Any], Measured]:
        """Return what was scored and what it is, of a trial."""
        model = self.asked.setup.task
        if self.push is not None:
            raise ValueError("--push is for policies; a recorded trial cannot be pushed")
        if model is not None and not isinstance(model, Path):
            raise ValueError(f"what is scored is a task or --trial, one of them; got {model!r} and {trial}")
        return {"trial": str(trial)}, _of_trial(trial, model, self.loads)

    def _walked(self) -> tuple[dict[str, Any], Measured]:
        """Return what was scored and what it is, of a policy."""
        from myowarp.apps.policies.find import acting, find_policy
        from myowarp.apps.reports.walk_measures import measured
        from myowarp.apps.rollouts.walks import pushed, walks_of
        from myowarp.motion.strides import strides_of
        from myowarp.sim.simulation import Simulation
        from myowarp.tasks.setups import complete

        if self.loads is not None:
            raise ValueError("--loads belongs to a recorded trial; give it with --trial FOLDER")
        setup = complete(self.asked.setup)
        policy = find_policy(self.policy, setup.spec)
        sim = Simulation(setup, self.num_worlds, autoreset="same_step")
        console = Console(stderr=True)
        walks = walks_of(sim, acting(policy, sim), console)
        name = f"{self.policy} in {setup.spec.env_id}"
        walk = measured(name, [strides_of(one, SETTLED) for one in walks.walks])
        under = None if self.push is None else pushed(sim, acting(policy, sim), self.push, console)
        sim.close()
        head: dict[str, Any] = {"task": setup.spec.env_id, "policy": self.policy, "physics": setup.physics}
        head |= {"muscle": setup.muscles.model, "conditions": list(map(str, setup.conditions or ()))}
        head |= {"seed": setup.seed, "faults": walks.faults, "one_episode": walks.one_episode}
        return head | ({} if under is None else {"pushed": asdict(under)}), walk


def _of_trial(trial: Path, model: Path | None = None, loads: Path | None = None) -> Measured:
    """Return what a recorded trial is."""
    from myowarp.apps.reports.walk_measures import measured
    from myowarp.motion.strides import strides_of
    from myowarp.motion.trial_walk import read_walk

    return measured(trial.name, [strides_of(read_walk(trial, model, loads))])
