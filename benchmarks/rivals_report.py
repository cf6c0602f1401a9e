"""What `benchmarks.rivals` measured, as a summary, tables and a plot."""

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

JUDGED_SIZE = 256  # worlds; the other sizes are in the table beside it
SIMPLE, FINGER, HAND, CONTACT = (
    (5.0, 8.0, 6.0, 10.0),
    (2.5, 4.0, 4.0, 6.0),
    (2.0, 3.5, 2.0, 3.5),
    (1.5, 2.5, 2.0, 3.3),
)
GOALS = {
    "elbow pose": SIMPLE,
    "finger pose": FINGER,
    "finger reach": FINGER,
    "hand pose": HAND,
    "hand reach": HAND,
    "key turn": CONTACT,
    "object hold": CONTACT,
    "pen twirl": CONTACT,
    "baoding": CONTACT,
}
"""What we want to reach: parity and fast over EnvPool, parity and fast over the better of MyoSuite's two."""
COLORS = {"parity": "#1f5fa8", "fast": "#d9822b"}


def _spread(values: Sequence[float], digits: int = 3) -> dict[str, float]:
    """Return median, least and greatest."""
    figures = {"median": statistics.median(values), "min": min(values), "max": max(values)}
    return {key: round(value, digits) for key, value in figures.items()}


def _rates(row: dict[str, Any]) -> list[float]:
    return [sample["rate"] for sample in row["samples"]]


def _ratios(row: dict[str, Any], rival: dict[str, Any]) -> dict[str, float]:
    """Return the ratio of rates, round by round."""
    return _spread([ours / theirs for ours, theirs in zip(_rates(row), _rates(rival), strict=True)])


def summarize(
    samples: dict[str, dict[str, Any]], tasks: dict[str, str], sizes: Sequence[int]
) -> dict[str, dict[str, Any]]:
    """Return for each family rates, memory, start-up and ratios of all contestants."""
    return {family: _summarize_family(rows, tasks[family], family, sizes) for family, rows in samples.items()}


def _summarize_family(rows: dict[str, Any], task: str, family: str, sizes: Sequence[int]) -> dict[str, Any]:
    contestants = {
        name: {
            "env_steps_per_s": _spread(_rates(row), 1),
            "peak_memory_mb": round(max(sample["memory"] for sample in row["samples"])),
            "start_s": row["start"] and round(row["start"], 2),
            "cores_busy_with_others": round(max(sample["others"] for sample in row["samples"]), 3),
        }
        | row["facts"]
        for name, row in rows.items()
    }
    better = max(
        ("MyoSuite", "MyoSuite async"), key=lambda name: contestants[name]["env_steps_per_s"]["median"]
    )
    ratios = {
        f"{physics} {size}": {
            rival: _ratios(rows[f"{physics} {size}"], rows[rival])
            for rival in ("EnvPool", "MyoSuite", "MyoSuite async", "MuJoCo C")
        }
        for physics in ("parity", "fast")
        for size in sizes
    }
    judged = JUDGED_SIZE if JUDGED_SIZE in sizes else sizes[0]
    names = ("parity/EnvPool", "fast/EnvPool", "parity/MyoSuite", "fast/MyoSuite")
    goals = {}
    for name, goal in zip(names, GOALS[family], strict=True):
        physics, _, rival = name.partition("/")
        measured = ratios[f"{physics} {judged}"][better if rival == "MyoSuite" else rival]
        goals[name] = {"goal": goal, "measured": measured, "reached": measured["median"] >= goal}
    summary = {"task": task, "contestants": contestants, "better_of_myosuite": better, "ratios": ratios}
    return summary | {"judged_worlds": judged, "goals": goals}


def print_tables(report: dict[str, Any], console: Console) -> None:
    """Print rates, and ratios beside their goals."""
    families = report["families"]
    names = list(next(iter(families.values()))["contestants"])
    rates = Table(title=f"env steps/s, median of {report['rounds']} rounds, {report['cores']} cores")
    for column in ("family", *names):
        rates.add_column(column, justify="left" if column == "family" else "right")
    for family, row in families.items():
        cells = (f"{row['contestants'][name]['env_steps_per_s']['median']:,.0f}" for name in names)
        rates.add_row(family, *cells)
    console.print(rates)
    memory = Table(title="peak memory [MB] / seconds from process start to first step")
    for column in ("family", *names):
        memory.add_column(column, justify="left" if column == "family" else "right")
    for family, row in families.items():
        figures = (row["contestants"][name] for name in names)
        memory.add_row(family, *(f"{one['peak_memory_mb']:,} / {one['start_s'] or 0:.1f}" for one in figures))
    console.print(memory)
    goals = Table(title="ratio (least to greatest of the rounds) and goal")
    for column in ("family", "worlds", *next(iter(families.values()))["goals"]):
        goals.add_column(column)
    for family, row in families.items():
        goals.add_row(family, str(row["judged_worlds"]), *(_verdict(goal) for goal in row["goals"].values()))
    console.print(goals)
    for family, seconds in report["start_seconds_of_myowarp"].items():
        console.print(f"{family}: first start {seconds['fresh']} s, second start {seconds['second']} s")


def _verdict(goal: dict[str, Any]) -> str:
    """Return a ratio beside its goal."""
    measured = goal["measured"]
    text = f"{measured['median']:.2f} ({measured['min']:.2f} to {measured['max']:.2f})"
    if goal["reached"]:
        return f"{text} [green]>= {goal['goal']:g}[/green]"
    return f"{text} [red]of {goal['goal']:g}, short by {1 - measured['median'] / goal['goal']:.0%}[/red]"


def draw(report: dict[str, Any], path: Path) -> None:
    """Draw the ratios to EnvPool and to the better of MyoSuite's two, with their goals."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    families = report["families"]
    figure, axes = plt.subplots(1, 2, figsize=(11, 1.4 + 0.62 * len(families)), sharey=True)
    for axis, rival, title in zip(
        axes, ("EnvPool", "MyoSuite"), ("EnvPool 1.2.5", "better of MyoSuite 3.0.0's two"), strict=True
    ):
        for k, physics in enumerate(("parity", "fast")):
            goals = [row["goals"][f"{physics}/{rival}"] for row in families.values()]
            measured = [goal["measured"] for goal in goals]
            medians = [one["median"] for one in measured]
            whiskers = [
                [one["median"] - one["min"] for one in measured],
                [one["max"] - one["median"] for one in measured],
            ]
            heights = [i + 0.2 * (2 * k - 1) for i in range(len(families))]
            axis.barh(
                heights, medians, 0.36, xerr=whiskers, color=COLORS[physics], label=physics, ecolor="0.3"
            )
            wanted = [goal["goal"] for goal in goals]
            axis.plot(wanted, heights, "|", color="k", ms=13, mew=1.8, label="goal" if k else None)
        axis.axvline(1.0, color="0.5", lw=1)
        axis.set_xlabel(f"environment steps/s over those of the {title}".replace("the EnvPool", "EnvPool"))
        axis.set_yticks(range(len(families)), list(families))
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_xlim(left=0)
    axes[0].invert_yaxis()
    axes[1].legend(frameon=False, loc="lower right")
    worlds = next(iter(families.values()))["judged_worlds"]
    figure.suptitle(
        f"MyoWarp, {worlds} worlds, {report['cores']} cores, median and range of {report['rounds']} rounds"
    )
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
