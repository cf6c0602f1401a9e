"""Conditions × policies: what a muscle condition does to a solved task, and what more training restores.

Open in the paper, and chosen here:

* Policies: those of the package that solve at least half of their episodes, one a task.
* Actions are drawn, as in training: with the policy's means a task with a fixed target has one episode.
* Training under a condition: a tenth of the samples that the policy had, with its own settings, under the
  physics of the evaluation. The value function, which the package does not keep, learns alone for 5
  iterations. The same training without a condition is the control.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.policies.baselines import PREFIX, Baseline, baseline_tasks, load_baseline
from myowarp.apps.policies.checkpoint import Checkpoint, check_contract
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.reports import panel
from myowarp.apps.reports.intervals import newcombe, wilson
from myowarp.apps.reports.result import PERCENT, Merit
from myowarp.apps.rollouts.episodes import Episodes
from myowarp.apps.rollouts.run import Each
from myowarp.apps.rollouts.run import run as roll
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab, Tick
from myowarp.apps.studies.reproduce.policies import NEVER, Training, available
from myowarp.definitions.condition import condition_from, resolve
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.kernels.episode import MYOSUITE
from myowarp.sim.simulation import Simulation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NONE = "none"
CONDITIONS = {
    "sarcopenia": "sarcopenia",
    "fatigue": "fatigue_ma2009(rate=60)",  # k = 1/s
    "tear": "tendon_tear",
    "transfer": "tendon_transfer",
    "exoskeleton": "exoskeleton",
}
ADAPTED = ("sarcopenia", "fatigue", "tear", "transfer")
SOLVED, LOSS = 50.0, 10.0  # percent of the episodes, points of it
COLORS = "Blues"
PART = 10  # times fewer samples than the policy had
NO_INTERVAL = "there is no interval over trainings; the notes have Wilson's 95 % intervals over episodes."
SEED = 2_000_000
QUICK_TASKS = ("myoElbowPose1D6MRandom-v0", "myoHandKeyTurnFixed-v0")
Runs = Mapping[tuple[str, str], Mapping[str, np.ndarray]]
"""By task and condition: whether each episode succeeded by the paper's rule, `success`, and its `fault`."""

Shares = Mapping[tuple[str, str], np.ndarray]
"""Of these, `success`."""


@cache
def baseline_of(task: str) -> Baseline:
    """Return a task's baseline, read once for all of its cells."""
    return load_baseline(task)


def applies(condition: str, task: str) -> bool:
    """Return whether a task's body can have a condition."""
    try:
        resolve(CONDITIONS[condition], TASKS[task])
    except ValueError:
        return False
    return True


def solved() -> list[str]:
    """Return the tasks whose policy in the package solves at least `SOLVED` of its episodes."""
    return [task for task in baseline_tasks() if _drawn(baseline_of(task)) >= SOLVED]


def _drawn(baseline: Baseline) -> float:
    """Return the success of a baseline's policy with drawn actions [%]."""
    return 100.0 * float(baseline.runs[0]["evaluation"]["sampled"][MYOSUITE])


def adaptation(task: str, condition: str) -> Training:
    """Return how a task's policy is trained on under a condition."""
    baseline = baseline_of(task)
    manifest, policy = baseline.checkpoint.manifest, baseline.checkpoint.policy
    settings: dict[str, Any] = {name: value for name, value in baseline.settings().items() if name != "seed"}
    samples = baseline.runs[0]["training"]["samples"] // PART
    settings |= {"physics": "parity", "stop_success": NEVER, "samples": samples, "selections": 0}
    if manifest["algorithm"] == "ppo":
        settings["value_first"] = 5
    if "log_std" in policy:
        settings["initial_std"] = float(np.exp(policy["log_std"]).mean().round(4))
    return Training(
        name=f"adapted_{task}_{condition}",
        task=task,
        conditions=lambda: () if condition == NONE else (condition_from(CONDITIONS[condition]),),
        samples=samples,
        settings=settings,
        algorithm=manifest["algorithm"],
        parent=PREFIX + task,
    )


def run(lab: Lab) -> Findings:
    """Run the protocol: every policy under every condition, then those that lost and were trained on."""
    tasks = [task for task in solved() if not lab.quick or task in QUICK_TASKS]
    cells = [(t, c) for t in tasks for c in (NONE, *CONDITIONS) if c == NONE or applies(c, t)]
    if lab.retrain:
        for task in tasks:
            baseline_of(task).check_trainer()
    lab.expect(len(cells))
    before = {(t, c): _episodes(lab, "before", t, c, baseline_of(t).checkpoint) for t, c in cells}
    shares = {cell: found["success"] for cell, found in before.items()}
    lost = [cell for cell in cells if cell[1] in ADAPTED and _loss(shares, *cell) > LOSS]
    wanted = sorted({(task, NONE) for task, _ in lost} | set(lost))
    again = [cell for cell in wanted if lab.retrain or available(adaptation(*cell))]
    lab.expect(len(again))
    after = {cell: _episodes(lab, "after", *cell, lab.policy(adaptation(*cell), 0)) for cell in again}
    return findings(before, after)


def _episodes(lab: Lab, when: str, task: str, condition: str, policy: Checkpoint) -> Mapping[str, np.ndarray]:
    """Return success and fault of the first episode of each world, drawn actions, shape (num_worlds,)."""
    conditions = () if condition == NONE else (CONDITIONS[condition],)
    setup = Setup(task=task, conditions=conditions, physics="parity", seed=SEED)
    return episode_of_each_world(lab, f"{when}_{task}_{condition}", setup, policy)


def episode_of_each_world(lab: Lab, name: str, setup: Setup, policy: Checkpoint) -> Mapping[str, np.ndarray]:
    """Return success by the paper's rule and fault of an episode of each world, drawn actions.

    It is the first episode; without resets it is the second, which starts where the first has ended.

    Args:
        lab: Number of worlds, and where runs are kept.
        name: Name of the run.
        setup: Task, conditions, reset, physics and seed.
        policy: Acts.

    Returns:
        `success` bool and `fault`, each of shape (num_worlds,).
    """
    before = int(setup.reset == "none")

    def measure(tick: Tick) -> dict[str, np.ndarray]:
        sim = Simulation(setup.over(lab.setup), lab.num_worlds, autoreset="same_step", progress=False)
        check_contract(policy, sim)
        steps, episodes = (1 + before) * sim.horizon, Episodes(lab.num_worlds)
        bar = Each(lambda step: tick(step.number / steps))
        act = LearnedPolicy(policy, Setup(seed=setup.seed))
        roll(sim, act, steps, episodes, bar, until=lambda: bool(not before and episodes.ended_once.all()))
        sim.close()
        found = episodes.first(after=before)
        return {"success": found[MYOSUITE], "fault": found["fault"]}

    settings: dict[str, Any] = {"task": setup.task, "conditions": list(setup.conditions or ())}
    settings |= {"reset": setup.reset} if setup.reset else {}
    settings |= {"seed": setup.seed, "num_worlds": lab.num_worlds}
    return lab.kept(name, settings, measure, policy)


def _loss(shares: Shares, task: str, condition: str) -> float:
    """Return what a condition costs a policy [points of success]."""
    return 100.0 * float(shares[task, NONE].mean() - shares[task, condition].mean())


def apart(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Return a 95 % interval of how many points more of the second episodes succeed than of the first."""
    low, high = newcombe(int(first.sum()), len(first), int(second.sum()), len(second))
    return 100.0 * low, 100.0 * high


def findings(runs_before: Runs, runs_after: Runs) -> Findings:
    """Return figures of merit, claims and figure.

    Args:
        runs_before: Of the policies as they are in the package.
        runs_after: Of those that were trained on.
    """
    runs = runs_before, runs_after
    before, after = ({cell: found["success"] for cell, found in own.items()} for own in runs)
    faults = [int(np.count_nonzero(found["fault"])) for own in runs for found in own.values()]
    rows = [row("success", ", ".join(cell), own) for cell, own in before.items()]
    rows += [row("success after more training", ", ".join(cell), own) for cell, own in after.items()]
    harmed = [c for c in before if c[1] != NONE and apart(before[c[0], NONE], before[c])[1] < -LOSS]
    spared = [c for c in before if c[1] != NONE and apart(before[c[0], NONE], before[c])[0] > -LOSS]
    adapted = [c for c in after if c[1] != NONE]
    gained = [c for c in adapted if apart(before[c], after[c])[0] > 0.0]
    restored = [c for c in adapted if apart(before[c[0], NONE], after[c])[0] > -LOSS]
    short = [c for c in adapted if apart(before[c[0], NONE], after[c])[1] < -LOSS]
    control = [c for c in after if c[1] == NONE and abs(100.0 * (after[c].mean() - before[c].mean())) > LOSS]
    worst = max((c for c in before if c[1] != NONE), key=lambda c: _loss(before, *c))
    pairs = len([c for c in before if c[1] != NONE])
    holds = {
        "harmed": bool(harmed),
        "every": len(harmed) == pairs or (False if spared else None),
        "gained": len(gained) == len(adapted) if adapted else None,
        "restored": len(restored) == len(adapted) or (False if short else None) if adapted else None,
        "control": not control,
    }
    measured = {
        "policies": len({task for task, _ in before}),
        "pairs": pairs,
        "episodes": len(next(iter(before.values()))),
        "harmed": len(harmed),
        "spared": len(spared),
        "adapted": len(adapted),
        "gained": len(gained),
        "restored": len(restored),
        "short": _listed(short),
        "control": _listed(control),
        "worst": f"{worst[0]} under {worst[1]}",
        "worst_loss": _loss(before, *worst),
        "faults": sum(faults),
        "all": sum(len(own) for shares in (before, after) for own in shares.values()),
        "lines": "\n".join(_line(c, before, after) for c in adapted) or "* none",
    }
    over = f"One training a task, so {NO_INTERVAL}"
    return Findings(rows, holds, lambda figure: draw(figure, before, after), measured, over)


def row(quantity: str, what: str, own: np.ndarray) -> Merit:
    """Return the row of a policy in a task under a condition.

    Args:
        quantity: Success, and when.
        what: Task and condition.
        own: Whether each world's episode succeeded.
    """
    low, high = wilson(int(own.sum()), len(own))
    note = f"{100 * low:.1f} to {100 * high:.1f} (Wilson, {len(own)} episodes)"
    return Merit(quantity, "%", what, [100.0 * own.mean()], note=note, within=PERCENT)


def _listed(cells: list[tuple[str, str]]) -> str:
    """Return tasks and conditions as a list in a sentence."""
    return ", ".join(f"{task} ({condition})" for task, condition in cells) or "none"


def _line(cell: tuple[str, str], before: Shares, after: Shares) -> str:
    """Return what a condition took and more training gave back, a line of a list."""
    task, _ = cell
    shares = (before[task, NONE], before[cell], after[cell], after[task, NONE])
    intact, lost, found, control = (100.0 * own.mean() for own in shares)
    samples = adaptation(*cell).samples
    return (
        f"* {task}, {cell[1]}: {intact:.0f} % without it, {lost:.0f} % with it, {found:.0f} % after "
        f"{samples:,} samples (control {control:.0f} %)"
    )


def draw(figure: Figure, before: Shares, after: Shares) -> None:
    """Draw two maps of success: tasks by conditions, as they are and after more training."""
    tasks, names = list(dict.fromkeys(task for task, _ in before)), (NONE, *CONDITIONS)
    figure.set_size_inches(8.0, 1.6 + 0.27 * len(tasks))
    panels = figure.subplots(1, 2, sharey=True)
    titles = "success of the policies", "after a tenth of the samples more"
    for axes, shares, title in zip(panels, (before, after), titles, strict=True):
        values = np.array(
            [[100.0 * shares[t, c].mean() if (t, c) in shares else np.nan for c in names] for t in tasks]
        )
        image = axes.imshow(values, cmap=COLORS, vmin=0.0, vmax=100.0, aspect="auto")
        for (row, column), value in np.ndenumerate(values):
            if np.isfinite(value):
                ink = panel.ink_on(image.to_rgba(value))
                axes.text(column, row, f"{value:.0f}", ha="center", va="center", fontsize=7.5, color=ink)
        axes.set_xticks(range(len(names)), names, rotation=35, ha="right")
        axes.set_title(title)
        axes.grid(False)
    panels[0].set_yticks(range(len(tasks)), [t.removeprefix("myo") for t in tasks])
    figure.colorbar(panels[0].images[0], ax=panels, label="episodes that succeed [%]", fraction=0.04)


EXPERIMENT = Experiment("conditions", run, ignores=("models", "seeds"))
