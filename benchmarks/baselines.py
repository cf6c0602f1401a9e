"""Baselines of the package: add runs of `myowarp train`, and write the page of all results.

    python -m benchmarks.baselines --add runs/hand    # evaluate it, 256 episodes under parity; then the page
    python -m benchmarks.baselines --evaluate ID      # evaluate a committed policy again; then the page
    python -m benchmarks.baselines                    # docs/baselines.md and docs/baselines.png alone

A run of a task that has a baseline replaces the run of the same seed, and all runs of an earlier trainer; the
policy that acts is that of the lowest seed. The policy that it started from goes with it, unless that is the
baseline of another task.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from typing import Any

from myowarp.apps.policies import baselines
from myowarp.apps.policies.baselines import CURVE, RESULT, Baseline, load_baseline
from myowarp.apps.policies.checkpoint import POLICY, Checkpoint, load_checkpoint, save_policy
from myowarp.apps.reports.curve import CSV
from myowarp.apps.reports.evaluation import SUCCESSES, evaluate_policy, plan_evaluation, success_text
from myowarp.apps.reports.table import markdown
from myowarp.apps.train.run import REPORT
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.disk import in_place
from myowarp.inks import INKS
from myowarp.kernels.episode import MYOSUITE
from myowarp.sim.economy import as_text

DOCS = Path(__file__).parents[1] / "docs"
PUBLISHED = Path(__file__).with_name("published_success.json")
PAGE = Path(__file__).with_name("baselines_page.md")
AUDIT = DOCS / "audit/audit.json"
MOST_BYTES = 800_000  # of a policy; legs, 403 observations and 80 muscles, take 770 kB
CURVE_ROWS = 150
CURVE_COLUMNS = ("samples", "return", *SUCCESSES)
MODES = {"deterministic": "mean", "sampled": "drawn"}
"""Kinds of actions, as evaluations and as pages call them."""
RULES = {MYOSUITE: "more than 5 solved steps"} | {
    rule: text for rule, text in SUCCESSES.items() if rule != "success"
}
"""Success as MyoSuite and the paper count it, and two more rules; all that evaluations of before have."""
WALK = "myoLegWalk-v0"
LEFT_OUT = ("checkpoint",)  # of an evaluation: a path of the machine


def add(run: Path) -> None:
    """Evaluate a run and make it a baseline.

    Raises:
        ValueError: The run is not finished, or its policy is too large.
    """
    checkpoint = load_checkpoint(run)
    if not (run / REPORT).is_file():
        raise ValueError(f"run {str(run)!r} has no {REPORT}; let it end, or stop it with Ctrl-C")
    training = json.loads((run / REPORT).read_text())
    task, folder = checkpoint.task, baselines.FOLDER / checkpoint.task
    entry = {"training": training, "evaluation": _evaluation(run, None)}
    if (corrected := task.replace("-v0", "-v1")) in set(TASKS) - {task}:
        entry["corrected"] = _evaluation(run, corrected)
    earlier = load_baseline(task) if (folder / RESULT).is_file() else None
    before = earlier.runs if earlier is not None and earlier.is_todays else []
    runs = [other for other in before if other["training"]["seed"] != training["seed"]]
    runs.append(entry)
    runs.sort(key=lambda other: other["training"]["seed"])
    if runs[0]["training"] is training:
        size = sum(array.nbytes for array in checkpoint.policy.values())
        if size > MOST_BYTES:
            raise ValueError(
                f"policy of {task!r} has {size} bytes, at most {MOST_BYTES} are allowed; --hidden 128 128"
            )
        save_policy(folder, _with_parent(checkpoint, folder))
        _write_curve(run / CSV, folder / CURVE)
    _write_result(folder, runs)


def _with_parent(checkpoint: Checkpoint, folder: Path) -> Checkpoint:
    """Put the policy that a run started from into the package; return the run's, which names it there.

    Raises:
        ValueError: It has changed since.
    """
    task, settings = checkpoint.task, checkpoint.manifest["settings"]
    name, shipped = settings.get("parent"), f"{baselines.PREFIX}{task}/{baselines.PARENT}"
    if not name or name == shipped or (name.startswith(baselines.PREFIX) and not name.endswith(task)):
        return checkpoint
    source = baselines.policy_folder(name, task)
    if source is None:
        raise ValueError(f"the run of {task!r} started from {name!r}, which is gone; train it again")
    parent = load_checkpoint(source)
    if parent.manifest["files"][POLICY]["sha256"] != checkpoint.manifest["parent"]["sha256"]:
        raise ValueError(f"the run of {task!r} started from {name!r}, which has changed; train it again")
    save_policy(folder / baselines.PARENT, parent)
    manifest = checkpoint.manifest | {"settings": settings | {"parent": shipped}}
    return Checkpoint(checkpoint.folder, manifest, checkpoint.policy)


def evaluate_again(task: str) -> None:
    """Replace the evaluation of the policy that a baseline has, that of its first run."""
    folder = baselines.FOLDER / task
    runs = load_baseline(task).runs
    runs[0]["evaluation"] = _evaluation(folder, None)
    if "corrected" in runs[0]:
        runs[0]["corrected"] = _evaluation(folder, task.replace("-v0", "-v1"))
    _write_result(folder, runs)


def _write_result(folder: Path, runs: list[dict[str, Any]]) -> None:
    """Write the runs of a baseline."""
    with in_place(folder / RESULT) as scratch:
        scratch.write_text(json.dumps({"runs": runs}, indent=1) + "\n")


def _evaluation(run: Path, task: str | None) -> dict[str, Any]:
    """Return the figures of a run's policy in its task, or in another one."""
    head, figures = evaluate_policy(plan_evaluation(run, Setup(task=task)))
    return {name: value for name, value in head.items() if name not in LEFT_OUT} | figures


def _write_curve(source: Path, target: Path) -> None:
    """Write some rows of a run's figures, the last one among them."""
    with source.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["return"] not in ("", "nan")]
    every = max(1, -(-len(rows) // CURVE_ROWS))
    with in_place(target) as scratch, scratch.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(CURVE_COLUMNS)
        for row in rows[::-1][::every][::-1]:
            writer.writerow(f"{float(row[name]):.6g}" for name in CURVE_COLUMNS)


def page() -> str:
    """Return the page of all baselines as Markdown."""
    found = [load_baseline(task) for task in baselines.baseline_tasks()]
    published = json.loads(PUBLISHED.read_text())
    machines = {(run["training"]["processor"], run["training"]["cores"]) for b in found for run in b.runs}
    faults = sum(_faults(run) for b in found for run in b.runs)
    audits = {audit["task"]: audit for audit in json.loads(AUDIT.read_text())["audits"]}
    met = 100.0 * audits["myoHandReachRandom-v0"]["targets"]["solvable"]
    todays = [f"`{one.task}`" for one in found if one.is_todays]
    return PAGE.read_text().format(
        todays=" and ".join(filter(None, (", ".join(todays[:-1]), *todays[-1:]))) or "none",
        summary=_summary_table(found, published),
        success=_success_table(found),
        failed=_failed_table(found),
        **{f"walk_{mode}": _walk(found, mode) for mode in MODES},
        faults=faults,
        reachable=_reachable(found),
        met=met,
        machine=", ".join(f"{cores} cores ({name})" for name, cores in sorted(machines)),
        training=_training_table(found),
        published=_published_table(found, published),
    )


def _faults(run: dict[str, Any]) -> int:
    """Return how many episodes of a run's evaluation ended by a fault."""
    evaluations = (run["evaluation"], *([run["corrected"]] if "corrected" in run else []))
    return sum(evaluation[mode]["faults"] for evaluation in evaluations for mode in MODES)


def _over_seeds(baseline: Baseline, mode: str, rule: str = MYOSUITE) -> str:
    """Return mean, and the worst where there are several seeds [%]."""
    shares = [100.0 * run["evaluation"][mode][rule] for run in baseline.runs]
    worst = f" ({min(shares):.1f})" if len(shares) > 1 else ""
    return f"{sum(shares) / len(shares):.1f}{worst}"


def _summary_table(found: list[Baseline], published: dict[str, Any]) -> str:
    """Return a row for each task of the paper, with mean and worst over seeds."""
    ours = {baseline.task: baseline for baseline in found}
    rows = []
    for task in dict.fromkeys((*published["tasks"], *sorted(ours))):
        if task not in ours:
            rows.append([f"`{task}`", "0", "no policy", "", "", ""])
            continue
        baseline = ours[task]
        shares = [_over_seeds(baseline, mode) for mode in MODES]
        shares.append(_over_seeds(baseline, "deterministic", "success_last"))
        most = max(run["training"]["samples"] for run in baseline.runs) / 1e6
        minutes = max(run["training"]["training_cpu_seconds"] for run in baseline.runs) / 60.0
        took = f"{minutes:.{int(minutes < 10)}f} min"
        algorithm = baseline.checkpoint.manifest["algorithm"].replace("flashsac", "sac")
        rows.append([f"`{task}`", str(len(baseline.runs)), *shares, f"{algorithm}, {most:.2f} M, {took}"])
    columns = ["task", "seeds", *(f"{name} actions" for name in MODES.values()), "mean actions, last step"]
    return markdown([*columns, "algorithm, samples, time of a core"], rows) + "\n"


def _success_table(found: list[Baseline]) -> str:
    """Return success by three rules, mean over drawn actions."""
    rows = []
    for baseline in found:
        for run in baseline.runs:
            for evaluation in (run["evaluation"], run.get("corrected")):
                for mode in MODES if evaluation else ():
                    shares = (success_text(evaluation[mode], rule) for rule in RULES)
                    task = evaluation["task"].removeprefix("MyoWarp/")
                    rows.append([f"`{task}`", str(run["training"]["seed"]), MODES[mode], *shares])
    return markdown(["task", "seed", "actions", *RULES.values()], rows) + "\n"


def _failed_table(found: list[Baseline]) -> str:
    """Return what is left of success where episodes failed, of the policies that come with the package."""
    rows = []
    for baseline in found:
        run = baseline.runs[0]
        for evaluation in (run["evaluation"], run.get("corrected")):
            for mode in MODES if evaluation else ():
                figures = evaluation[mode]
                if figures.get("failed"):
                    shares = (success_text(figures, rule) for rule in (MYOSUITE, "success"))
                    task = evaluation["task"].removeprefix("MyoWarp/")
                    failed = f"{figures['failed']} of {figures['episodes']}"
                    rows.append([f"`{task}`", MODES[mode], *shares, failed])
    return markdown(["task", "actions", "MyoSuite's rule", "strict rule", "failed"], rows) + "\n"


def _walk(found: list[Baseline], mode: str) -> str:
    """Return speed, metabolic rate and cost of transport of the legs that walk."""
    return as_text(next(b for b in found if b.task == WALK).runs[0]["evaluation"][mode])


def _reachable(found: list[Baseline]) -> str:
    """Return success over targets that can be met exactly, where some cannot."""
    lines = []
    for baseline in found:
        figures = baseline.runs[0]["evaluation"]
        means = figures["deterministic"]
        count, episodes = means.get("reachable"), means["episodes"]
        if count and count < episodes:
            shares = (f"{success_text(figures[m], 'success_reachable')} with {MODES[m]}" for m in MODES)
            lines.append(
                f"* `{baseline.task}`: {count} of {episodes} targets; {', '.join(shares)} actions.\n"
            )
    return "".join(lines)


def _training_table(found: list[Baseline]) -> str:
    """Return what the training took, and the command that remakes it."""
    rows = []
    for baseline in found:
        for run in baseline.runs:
            training = run["training"]
            seed = "" if run is baseline.runs[0] else f" --seed {training['seed']}"
            rows.append(
                [
                    f"`myowarp baselines run {baseline.task}{seed}`",
                    training["algorithm"],
                    _trained_under(training),
                    f"{training['samples'] / 1e6:.2f}",
                    "-" if training.get("resumed_after") else f"{training['seconds']:.0f}",
                    f"{training['training_seconds']:.0f}",
                    f"{training['training_cpu_seconds']:.0f}",
                    f"{training['cores_busy_with_others']:.2f}",
                    training["ended"],
                ]
            )
    columns = [
        "command",
        "algorithm",
        "physics",
        "samples [million]",
        "wall [s]",
        "training [s]",
        "CPU [s]",
        "busy cores",
    ]
    return markdown([*columns, "ended by"], rows) + "\n"


def _trained_under(training: dict[str, Any]) -> str:
    """Return the physics of a training, both where parity physics took over."""
    after = training.get("parity_after", 0)
    return training["physics"] + (f", parity after {after / 1e6:.1f} M" if after else "")


def _published_table(found: list[Baseline], published: dict[str, Any]) -> str:
    """Return our success beside that of others."""
    ours = {}
    for baseline in found:
        shares = " / ".join(_over_seeds(baseline, mode) for mode in MODES)
        most = max(run["training"]["samples"] for run in baseline.runs) / 1e6
        ours[baseline.task] = f"{shares}; {len(baseline.runs)} ({most:.2f} M)"
    sources = published["sources"]
    rows = [
        [f"`{task}`", ours.get(task, "no policy"), *(theirs.get(name, "-") for name in sources)]
        for task, theirs in published["tasks"].items()
    ]
    heads = {"npg": "the paper's NPG", "ppo": "MyoSuite 3, PPO on a GPU", "off_policy": "FlashSAC"}
    table = markdown(["task", "MyoWarp", *(heads[name] for name in sources)], rows)
    return table + "\n\n" + "".join(f"* {heads[name]}. {text}\n" for name, text in sources.items())


def draw(path: Path) -> None:
    """Draw the curves of all baselines: success over samples, a panel for each task."""
    from matplotlib.figure import Figure

    tasks, columns = baselines.baseline_tasks(), 4
    rows = -(-len(tasks) // columns)
    figure = Figure(figsize=(11, 2.1 * rows), layout="constrained")
    panels = list(figure.subplots(rows, columns, sharey=True, squeeze=False).flat)
    for panel, task in zip(panels, tasks, strict=False):
        with (baselines.FOLDER / task / CURVE).open(newline="") as file:
            points = [(float(row["samples"]) / 1e6, row) for row in csv.DictReader(file)]
        for (rule, text), ink in zip(SUCCESSES.items(), INKS, strict=False):
            shares = [100 * float(row[rule]) for _, row in points]
            panel.plot([x for x, _ in points], shares, color=ink, label=text)
        panel.set_title(task, fontsize="small")
        panel.set(ylim=(-2, 102), xlim=(0, None))
        panel.tick_params(labelsize="small")
    for panel in panels[len(tasks) :]:
        panel.axis("off")
    figure.supxlabel("samples [million]", fontsize="small")
    figure.supylabel("success [%]", fontsize="small")
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False
    )
    figure.savefig(path, dpi=110)


def main() -> None:
    """Add runs, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--add", nargs="*", type=Path, default=[], metavar="RUN", help="folders of runs")
    parser.add_argument("--evaluate", nargs="*", default=[], metavar="ID", help="baselines")
    arguments = parser.parse_args()
    for run in arguments.add:
        add(run)
        print(f"Added {run}")
    for task in arguments.evaluate:
        evaluate_again(task)
        print(f"Evaluated {task}")
    with in_place(DOCS / "baselines.md") as scratch:
        scratch.write_text(page())
    draw(DOCS / "baselines.png")
    print(f"Wrote {DOCS / 'baselines.md'} and baselines.png")


if __name__ == "__main__":
    main()
