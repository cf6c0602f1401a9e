"""The work of `myowarp cohort`."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from myowarp.apps.reports import panel
from myowarp.apps.reports.evaluation import SUCCESSES, passing
from myowarp.apps.reports.table import number, terminal
from myowarp.apps.studies.cohort.plan import plan_cohort
from myowarp.apps.studies.cohort.plot import draw_cohort, group_patients
from myowarp.apps.studies.cohort.run import CohortResult, result_files, run_plan
from myowarp.apps.studies.parts import LOCK
from myowarp.disk import check_folder, check_overwrite, locked, make_folder
from myowarp.extras import to_install
from myowarp.sim.economy import UNITS as ECONOMY
from myowarp.sim.economy import doubt, heading

if TYPE_CHECKING:
    import pandas as pd

PLOT, ASSISTANCE = "plot.png", "assistance.png"


def run(table: Path, output: Path, suffix: str, console: Console, overwrite: bool, **settings: Any) -> None:
    """Check everything, run the cohort, write results and plot into `output`, and print figures.

    Raises:
        ValueError: An argument or an entry of the table is wrong, or another process writes into the folder;
            nothing was built or written.
        ImportError: pandas or pyarrow is not installed.
        OSError: The files cannot be written.
    """
    check_folder(output)
    plan = plan_cohort(table, **settings)
    make_folder(output)
    with locked(output / LOCK, wait=False):
        check_overwrite((output / name for name in (*result_files(suffix), PLOT, ASSISTANCE)), overwrite)
        result = run_plan(plan, console)
        paths = [*result.save(output, suffix), *_plots(result, output, console)]
    Console().print(figures(result))
    summary = result.summary
    said = (
        repeated(summary),
        passing(summary["success"].mean(), summary["success_last"].mean()),
        doubt({**summary.filter(ECONOMY).max(), "body_mass": result.settings["body_mass"]}),
    )
    for text in filter(None, said):
        console.print(text, style="yellow", markup=False)
    for path in paths:
        console.print(f"Saved {path}")


def _plots(result: CohortResult, output: Path, console: Console) -> list[Path]:
    """Draw the plots into a folder, where matplotlib is installed; return their files."""
    if importlib.util.find_spec("matplotlib") is None:
        console.print(f"No plot: it needs matplotlib; run {to_install('plot')}", style="yellow", markup=False)
        return []
    from myowarp.apps.studies.cohort.assistance import assistance_map, crosses

    paths = [output / PLOT]
    draw_cohort(result, paths[0])
    if crosses(result.summary):
        paths.append(output / ASSISTANCE)
        with panel.style(9.5):
            panel.save(assistance_map(result.summary, result.settings), paths[-1], dpi=130)
    return paths


def repeated(summary: pd.DataFrame) -> str:
    """Return a sentence where the trials of each patient are one and the same, else ""."""
    trials = summary.groupby("patient", observed=True)["return"]
    if summary["trial"].nunique() < 2 or (trials.nunique(dropna=False) > 1).any():
        return ""
    return "all trials of a patient are the same: task, policy and patient draw nothing; one tells as much"


def _between_patients(result: CohortResult) -> Iterator[tuple[str, str]]:
    """Yield success at the end by groups of patients, of columns of numbers that vary."""
    summary = result.summary
    for name in result.settings["columns"]:
        if summary[name].dtype.kind in "fiu" and summary[name].nunique() > 1:
            groups = group_patients(summary[name])
            shares = (100.0 * summary["success_last"][member].mean() for member in groups.members)
            parts = zip(shares, groups.labels, strict=True)
            yield f"  by {name}", ", ".join(f"{share:.0f} % ({own})" for share, own in parts)


def figures(result: CohortResult) -> Table:
    """Return the main figures as a table."""
    summary, settings = result.summary, result.settings
    rows = {
        "patients": f"{settings['patients']:,}",
        "task": settings["task"],
        "policy": settings["policy"],
        "trials of each patient": str(settings["trials"]),
        "control steps": str(settings["steps"]),
        "conditions": ", ".join(settings["conditions"]) or "none",
        SUCCESSES["success_last"]: f"{100 * summary['success_last'].mean():.1f} %",
        **dict(_between_patients(result)),
        "successful": f"{100 * summary['success'].mean():.1f} % ({SUCCESSES['success']})",
        "failed": f"{summary['failed'].sum():,} of {len(summary):,} episodes",
    }
    if "final_error" in summary:
        low, middle, high = summary["final_error"].quantile([0.25, 0.5, 0.75])
        unit = settings["units"]["final_error"]
        rows["error in the last quarter of the episode"] = (
            f"median {middle:.3g} {unit} (quartiles {low:.3g}, {high:.3g})"
        )
    rows["mean activation"] = f"{summary['mean_activation'].mean():.3f}"
    walks = "speed" in settings["units"]  # rates of a part of a person are in the files alone
    known = {name: summary[name].mean() for name in ECONOMY if walks}
    rows |= {heading(name, settings["body_mass"]): number(mean) for name, mean in known.items()}
    rows["faults"] = str(summary["fault"].notna().sum())
    return terminal((), rows.items())
