"""The command `myowarp adapt`: policies in patients who change in mid-episode."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from myowarp.apps.cli.options import Environment, Overwrite, optional
from myowarp.definitions.registry import check_least

if TYPE_CHECKING:
    from myowarp.apps.studies import adaptation


@dataclass
class Adapt:
    """Compare what policies do once a patient has changed in mid-episode, each in the same episodes.

    Conditions or a cohort say what changes and when. Success before the change, its drop, the time to recover
    half of it, and the share of solved steps after it, with 95 % intervals; the first policy is the one to
    beat. Writes adaptation.json, curves.csv and adaptation.png.

    Example: myowarp adapt myoElbowPose1D6MRandom-v0 --cohort examples/changing.csv
    """

    asked: Environment
    policies: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[NAME ...]")] = ("baseline",)
    """Policies, each as in `rollout --policy`."""
    cohort: Annotated[Path | None, optional("TABLE")] = None
    """Patient table whose entries change; every patient has as many episodes."""
    episodes: int = 1024
    """Episodes of each policy, and worlds simulated together."""
    board: Annotated[Path | None, optional("TABLE")] = None
    """Leaderboard (.csv) that the figures are entered into, if they are by its protocol."""
    output: Path = Path("out/adapt")
    """Folder of the results."""
    overwrite: Overwrite = False
    json: bool = False
    """Print JSON instead of a table."""

    def __call__(self) -> None:
        """Check, run and print."""
        from myowarp.apps.policies.find import find_policy
        from myowarp.apps.reports.evaluation import EVALUATION_SEED
        from myowarp.apps.studies import adaptation, leaderboard
        from myowarp.definitions.setup import Setup
        from myowarp.disk import check_folder, check_overwrite, plain
        from myowarp.sim.build import MOST_WORLDS
        from myowarp.tasks.setups import complete

        check_least(2, MOST_WORLDS, episodes=self.episodes)
        check_least(1, policies=len(self.policies))
        check_folder(self.output)
        check_overwrite((self.output / adaptation.RESULT,), self.overwrite)
        console = Console(stderr=True)
        setup = complete(self.asked.setup.over(Setup(seed=EVALUATION_SEED)))
        policies = [find_policy(name, setup.spec) for name in self.policies]
        if self.board is not None:
            leaderboard.check_protocol(setup, self.policies, self.episodes)
            leaderboard.read_board(self.board)
        patients = leaderboard.patients_of(setup, self.cohort)
        if self.cohort is not None:
            setup = adaptation.with_patients(setup, self.cohort, self.episodes)
        result = adaptation.study(setup, policies, self.episodes, console)
        files = adaptation.save(result, self.output)
        if self.board is not None:
            leaderboard.enter(result, patients, self.board)
            files = (*files, self.board)
        if self.json:
            print(json.dumps(plain([asdict(policy) for policy in result.policies]), indent=1))
        else:
            _print_table(result)
        console.print(f"Saved {', '.join(map(str, files))}")


def _print_table(result: adaptation.Adaptation) -> None:
    """Print a row for each policy."""
    console = Console(highlight=False)
    console.print(
        f"{result.setup.spec.env_id}: {result.policies[0].episodes} episodes with a change, "
        f"{result.setup.physics} physics"
    )
    table = Table("policy", "before [%]", "drop [%]", "half back [s]", "solved after [%]", "gain [%]")
    for row in result.policies:
        gain = "" if row.gain is None else _percent(row.gain, row.gain_interval)
        back = f"{row.recovery:.2f}" if math.isfinite(row.recovery) else "never"
        before, drop = _percent(row.before, row.before_interval), _percent(row.drop, row.drop_interval)
        table.add_row(row.policy, before, drop, back, _percent(row.after, row.after_interval), gain)
    console.print(table)


def _percent(value: float, interval: tuple[float, float] | None) -> str:
    """Return a share with its interval."""
    low, high = interval or (float("nan"),) * 2
    return f"{100 * value:.1f} ({100 * low:.1f} to {100 * high:.1f})"
