"""Results of `benchmarks.opensim_speed`, as tables and a plot.

python -m benchmarks.opensim_report    # draws the committed ones
"""

import json
import textwrap
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.result_pages import OPENSIM_SPEED, RESULTS, number
from myowarp.inks import BLUE, VERMILION

COLORS = {"OpenSim": VERMILION, "MuJoCo C": "#6b6b6b", "MyoWarp": BLUE}
STYLES = {"accuracy 1e-3": ":", "1 core": "--"}
LABEL_GAP = 1.5  # between labels, as a ratio of rates
LEAST_SHARE = 0.85  # of its cores that a contestant must have had
CAPTION = (
    "Same model, same constant excitation, every muscle replicated with its share of the force. OpenSim's "
    "tendons are elastic, the converted ones rigid. MuJoCo C and MyoWarp take steps of 2 ms; OpenSim chooses "
    "its own, for an accuracy of 1e-5 unless said. Bars: least and greatest of the rounds. Hollow: other "
    "processes took part of the cores."
)


def print_tables(report: dict[str, Any], console: Console) -> None:
    """Print rates, and ratios to OpenSim."""
    for name, model in report["models"].items():
        rows = model["copies"]
        contestants = list(next(iter(rows.values())))
        table = Table(title=f"{name}: simulated s per s, median of {report['rounds']} rounds (over OpenSim)")
        for column in ("muscles", *contestants):
            table.add_column(column, justify="right")
        for row in rows.values():
            cells = (f"{one['rate']['median']:g} ({one['over_opensim']['median']:g})" for one in row.values())
            table.add_row(str(row[contestants[0]]["muscles"]), *cells)
        console.print(table)


def draw(report: dict[str, Any], path: Path) -> None:
    """Draw simulated seconds per second over the number of muscles, a panel a model."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    models = report["models"]
    figure, axes = plt.subplots(1, len(models), figsize=(6.6 * len(models), 5.2), squeeze=False)
    for axis, (title, model) in zip(axes[0], models.items(), strict=True):
        rows = model["copies"].values()
        lines = {name: [row[name] for row in rows] for name in next(iter(rows))}
        heights = _heights([line[-1]["rate"]["median"] for line in lines.values()])
        for (name, line), height in zip(lines.items(), heights, strict=True):
            _line(axis, name, line, height)
        axis.set(xscale="log", yscale="log", xlabel="muscles")
        axis.set_title(f"{title}, episodes of {model['duration']:g} s", loc="left")
        muscles = [next(iter(row.values()))["muscles"] for row in rows]
        axis.set_xticks(muscles, [str(number) for number in muscles])
        axis.minorticks_off()
        axis.set_xlim(muscles[0] / 1.3, muscles[-1] * (muscles[-1] / muscles[0]) ** 0.62)
        axis.axhline(1.0, color="0.7", lw=0.8, zorder=0)
        axis.annotate(
            "real time",
            (axis.get_xlim()[1], 1.0),
            (0, -4),
            textcoords="offset points",
            ha="right",
            va="top",
            color="0.45",
        )
        axis.spines[["top", "right"]].set_visible(False)
    axes[0][0].set_ylabel("simulated seconds per second, all worlds")
    figure.text(0.01, 0.01, textwrap.fill(CAPTION, 105 * len(models)), fontsize=8, color="0.3")
    figure.tight_layout(rect=(0, 0.07, 1, 1))
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _heights(rates: list[float]) -> list[float]:
    """Return heights for labels of rates, moved up where they would overlap."""
    heights, last = list(rates), 0.0
    for i in sorted(range(len(rates)), key=rates.__getitem__):
        heights[i] = last = max(rates[i], LABEL_GAP * last)
    return heights


def _line(axis: Any, name: str, rows: list[dict[str, Any]], height: float) -> None:
    """Draw one contestant, its name at the end of its line with the ratio there."""
    family, _, detail = name.partition(", ")
    rates = [row["rate"] for row in rows]
    medians, muscles = [rate["median"] for rate in rates], [row["muscles"] for row in rows]
    whiskers = [
        [rate["median"] - rate["min"] for rate in rates],
        [rate["max"] - rate["median"] for rate in rates],
    ]
    style = {"color": COLORS[family], "ls": STYLES.get(detail, "-"), "marker": "o", "ms": 4}
    axis.errorbar(muscles, medians, yerr=whiskers, elinewidth=1, **style)
    for count, rate, row in zip(muscles, medians, rows, strict=True):
        if row["cpu_over_wall"]["median"] < LEAST_SHARE * row["threads"]:
            axis.plot(count, rate, "o", ms=4, mfc="w", mec=COLORS[family], zorder=5)
    ratio = rows[-1]["over_opensim"]["median"]
    worlds = f", {rows[-1]['worlds']} worlds" if rows[-1]["worlds"] > 1 else ""
    text = f"{name}{worlds}" + ("" if ratio == 1.0 else f": {number(ratio, 3)} ×")
    axis.annotate(
        text,
        (muscles[-1], height),
        (8, 0),
        textcoords="offset points",
        va="center",
        color=COLORS[family],
        fontsize=9,
    )


if __name__ == "__main__":
    draw(json.loads(OPENSIM_SPEED.read_text()), RESULTS / "opensim_speed.png")
