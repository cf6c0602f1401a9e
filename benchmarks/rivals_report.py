"""Results of `benchmarks.rivals`, as a summary, tables and a plot."""

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from myowarp.inks import BLUE, ORANGE

JUDGED_SIZE = 256  # worlds; the other sizes are in the table beside it
AIMED_AT = ("parity/EnvPool", "fast/EnvPool", "parity/MyoSuite", "fast/MyoSuite")
SIMPLE, FINGER, HAND, CONTACT = (
    dict(zip(AIMED_AT, goals, strict=True))
    for goals in ((5.0, 8.0, 6.0, 10.0), (2.5, 4.0, 4.0, 6.0), (2.0, 3.5, 2.0, 3.5), (1.5, 2.5, 2.0, 3.3))
)
LIMBS = {"parity/MuJoCo C": 1.5, "fast/MuJoCo C": 5.0}
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
    "arm reach": LIMBS,
    "leg stand": LIMBS,
    "leg walk": LIMBS,
    "leg hills": LIMBS,
}
"""Ratios that we want to reach, to EnvPool and the better of MyoSuite's two, or to MuJoCo C."""
PRESETS = ("parity", "fast")
COLORS = {"parity": BLUE, "fast": ORANGE}


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
        (name for name in ("MyoSuite", "MyoSuite async") if name in rows),
        key=lambda name: contestants[name]["env_steps_per_s"]["median"],
        default=None,
    )
    ratios = {
        f"{physics} {size}": {
            rival: _ratios(rows[f"{physics} {size}"], rows[rival])
            for rival in ("EnvPool", "MyoSuite", "MyoSuite async", "MuJoCo C")
            if rival in rows
        }
        for physics in PRESETS
        for size in sizes
    }
    judged = JUDGED_SIZE if JUDGED_SIZE in sizes else sizes[0]
    summary = {"task": task, "contestants": contestants, "better_of_myosuite": better, "ratios": ratios}
    summary["judged_worlds"] = judged
    goals = {}
    for name, goal in GOALS.get(family, {}).items():
        measured = _ratio(summary, *name.split("/"))
        goals[name] = {"goal": goal, "measured": measured, "reached": measured["median"] >= goal}
    return summary | {"goals": goals}


def _ratio(row: dict[str, Any], physics: str, rival: str) -> dict[str, float] | None:
    """Return a family's ratio to a rival, or to the better of MyoSuite's two; None without the rival."""
    name = row["better_of_myosuite"] if rival == "MyoSuite" else rival
    return row["ratios"][f"{physics} {row['judged_worlds']}"].get(name)


def print_tables(report: dict[str, Any], console: Console) -> None:
    """Print rates, and ratios beside their goals."""
    families = report["families"]
    names = list(next(iter(families.values()))["contestants"])
    rates = Table(title=f"env steps/s, median of {report['rounds']} rounds, {report['cores']} cores")
    memory = Table(title="peak memory [MB] / seconds from process start to first step")
    for table in (rates, memory):
        for column in ("family", *names):
            table.add_column(column, justify="left" if column == "family" else "right")
    for family, row in families.items():
        figures = [row["contestants"].get(name) for name in names]
        rates.add_row(family, *(one and f"{one['env_steps_per_s']['median']:,.0f}" for one in figures))
        memory.add_row(
            family, *(one and f"{one['peak_memory_mb']:,} / {one['start_s'] or 0:.1f}" for one in figures)
        )
    goals = Table(title="ratio (least to greatest of the rounds) and goal")
    wanted = list(dict.fromkeys(name for row in families.values() for name in row["goals"]))
    for column in ("family", "worlds", *wanted):
        goals.add_column(column)
    for family, row in families.items():
        cells = (_verdict(_ratio(row, *name.split("/")), row["goals"].get(name)) for name in wanted)
        goals.add_row(family, str(row["judged_worlds"]), *cells)
    for table in (rates, memory, goals):
        console.print(table)
    for family, seconds in report["start_seconds_of_myowarp"].items():
        console.print(f"{family}: first start {seconds['fresh']} s, second start {seconds['second']} s")


def _verdict(measured: dict[str, float] | None, goal: dict[str, Any] | None) -> str:
    """Return a ratio, beside its goal where there is one."""
    if measured is None:
        return ""
    text = f"{measured['median']:.2f} ({measured['min']:.2f} to {measured['max']:.2f})"
    if goal is None:
        return text
    if goal["reached"]:
        return f"{text} [green]>= {goal['goal']:g}[/green]"
    return f"{text} [red]of {goal['goal']:g}, short by {1 - measured['median'] / goal['goal']:.0%}[/red]"


def draw(report: dict[str, Any], path: Path, rivals: dict[str, str]) -> None:
    """Draw the ratios to two rivals, with their goals.

    Args:
        report: What was measured.
        path: PNG to write.
        rivals: Which rivals, and what the axis calls each.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    families = report["families"]
    size = (11, 1.4 + 0.62 * len(families))
    figure, axes = plt.subplots(1, len(rivals), figsize=size, sharey=True)
    for axis, (rival, title) in zip(axes, rivals.items(), strict=True):
        for k, physics in enumerate(PRESETS):
            heights, medians, below, above, goals = [], [], [], [], []
            for i, row in enumerate(families.values()):
                height = i + 0.2 * (2 * k - 1)
                if (one := _ratio(row, physics, rival)) is not None:
                    heights.append(height)
                    medians.append(one["median"])
                    below.append(one["median"] - one["min"])
                    above.append(one["max"] - one["median"])
                if (goal := row["goals"].get(f"{physics}/{rival}")) is not None:
                    goals.append((goal["goal"], height))
            whiskers = [below, above]
            axis.barh(
                heights, medians, 0.36, xerr=whiskers, color=COLORS[physics], label=physics, ecolor="0.3"
            )
            if goals:
                axis.plot(*zip(*goals, strict=True), "|k", ms=13, mew=1.8, label="goal" if k else None)
        axis.axvline(1.0, color="0.5", lw=1)
        axis.set_xlabel(f"environment steps/s over those of {title}")
        axis.set_yticks(range(len(families)), list(families))
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_xlim(left=0)
        axis.legend(frameon=False, loc="lower right")
    axes[0].invert_yaxis()
    worlds = next(iter(families.values()))["judged_worlds"]
    figure.suptitle(
        f"MyoWarp, {worlds} worlds, {report['cores']} cores, median and range of {report['rounds']} rounds"
    )
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
