"""The command `myowarp baselines`: trained policies that come with the package."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from myowarp.apps.cli.options import Asked, environment, optional
from myowarp.apps.reports.evaluation import MODES, SUCCESSES, success_text
from myowarp.apps.train.settings import divided
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.kernels.episode import MYOSUITE

RULES = {MYOSUITE: "more than 5 solved steps, failed or not", **SUCCESSES}

if TYPE_CHECKING:
    from myowarp.apps.policies.baselines import Baseline


@dataclass
class Baselines:
    """List the trained policies that come with the package, or remake one and compare it with its table.

    Example: myowarp rollout myoFingerReachFixed-v0 --policy baseline --video finger.mp4

    Or: myowarp baselines run myoElbowPose1D6MRandom-v0
    """

    action: Annotated[Literal["list", "run"], tyro.conf.Positional]
    """list: all baselines, or the one of a task. run: train it again with its settings (needs the
    extra `train`), evaluate 256 episodes under parity, and compare."""
    asked: Annotated[Asked, environment(only=("task", "device", "seed"))]
    output: Annotated[Path | None, optional("FOLDER")] = None
    """run: new folder; by default runs/baseline_<task>_<seed>."""
    json: bool = False
    """Print JSON instead of a table."""

    def __call__(self) -> None:
        """Check, then list or run."""
        from myowarp.apps.policies import baselines

        asked = self.asked.setup
        task = str(asked.task).removeprefix("MyoWarp/") if asked.task else None
        if self.action == "list":
            names = [task] if task else baselines.baseline_tasks()
            _list([baselines.load_baseline(name) for name in names], self.json)
            return
        if task is None:
            raise ValueError(f"baselines run needs a task: {', '.join(baselines.baseline_tasks())}")
        baseline = baselines.load_baseline(task)
        baseline.check_trainer()
        setup, settings = divided(baseline.settings(asked.seed))
        setup = asked.over(setup)
        output = self.output or Path("runs") / f"baseline_{task}_{setup.seed}"
        now = _remake(baseline, output, setup, settings)
        self._report(baseline, now, output)

    def _report(self, baseline: Baseline, now: dict[str, Any], output: Path) -> None:
        """Print both sets of figures.

        Raises:
            RuntimeError: The baseline was not reached.
        """
        from myowarp.apps.policies.baselines import shortfall
        from myowarp.apps.policies.checkpoint import POLICY, load_checkpoint

        before = {mode: baseline.runs[0]["evaluation"][mode] for mode in now}
        remade = load_checkpoint(output).manifest["files"][POLICY]
        same = remade == baseline.checkpoint.manifest["files"][POLICY]
        if self.json:
            print(json.dumps({"task": baseline.task, "remade": now, "same_policy": same}, indent=1))
        else:
            console, table = Console(highlight=False), Table("", "baseline", "remade")
            for mode in now:
                for rule, text in RULES.items():
                    table.add_row(
                        f"{mode}: {text}", success_text(before[mode], rule), success_text(now[mode], rule)
                    )
            console.print(table)
            console.print(f"The policies are {'equal bit for bit' if same else 'not equal bit for bit'}.")
        if short := shortfall(now, before):
            raise RuntimeError(f"baseline {baseline.task!r} was not reached: {short}")


def _remake(
    baseline: Baseline, output: Path, setup: Setup, settings: dict[str, Any]
) -> dict[str, dict[str, Any]]:
    """Train a baseline again and evaluate it like the committed policy.

    Args:
        baseline: What is remade.
        output: New folder of the run.
        setup: In what.
        settings: Settings, such as those of `Baseline.settings`.

    Returns:
        Figures of each mode.
    """
    from myowarp.apps.reports.evaluation import evaluate_policy, plan_evaluation
    from myowarp.apps.train.plan import plan
    from myowarp.apps.train.run import train

    algorithm = baseline.checkpoint.manifest["algorithm"]
    train(plan(setup, algorithm=algorithm, output=output, **settings))
    return evaluate_policy(plan_evaluation(output, Setup(device=setup.device)))[1]


def _list(found: list[Baseline], as_json: bool) -> None:
    """Print baselines."""
    if as_json:
        print(json.dumps({baseline.task: {"runs": baseline.runs} for baseline in found}, indent=1))
        return
    columns = [f"{drawn}{rule} [%]" for drawn in ("", "drawn, ") for rule in ("strict", "paper")]
    table = Table(
        "task", "samples [M]", *columns, "today's trainer", box=SIMPLE, padding=(0, 1, 0, 0), show_edge=False
    )
    table.columns[0].no_wrap = True
    for baseline in found:
        run = baseline.runs[0]
        shares = (_share(run["evaluation"][mode], rule) for mode in MODES for rule in ("success", MYOSUITE))
        lowest = f"{TASKS[baseline.task].name}-v0"
        label = baseline.task + (" *" if lowest in TASKS and lowest != baseline.task else "")
        samples = f"{run['training']['samples'] / 1e6:.2f}"
        table.add_row(label, samples, *shares, "yes" if baseline.is_todays else "no")
    console = Console(highlight=False, soft_wrap=True)
    console.print(table, soft_wrap=False)
    console.print(
        f"strict: episodes with {SUCCESSES['success']}, as `myowarp eval` counts; "
        f"paper: {RULES[MYOSUITE]}, MyoSuite's rule.\n"
        "256 episodes with the policy's means as actions, and 256 with drawn ones, under parity physics; 1 of"
        " 1: all 256 are the same; -: not counted; *: a corrected task.\nyes: today's trainer made the"
        " policy, and `myowarp baselines run ID` makes it again; no: an earlier one did.\nA -v1 id without a"
        " row takes the policy of its -v0 (`--policy baseline`).\n--json has every seed, intervals and two"
        " more rules.",
        markup=False,
    )


def _share(figures: dict[str, Any], rule: str) -> str:
    """Return a success in percent, or of the one episode that all were; "-": it was not counted."""
    if rule not in figures:
        return "-"
    return f"{figures[rule]:.0f} of 1" if figures["one_episode"] else f"{100 * figures[rule]:.1f}"
