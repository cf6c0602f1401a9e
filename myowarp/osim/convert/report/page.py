"""The report of a conversion as one page that needs nothing else: `report.html`."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from myowarp.inks import BLUE, GREEN, ORANGE, RED, VERMILION
from myowarp.osim.convert.check.dynamics import Dynamics
from myowarp.osim.convert.compose.convert import Converted
from myowarp.osim.convert.compose.visible_body import bones
from myowarp.osim.convert.report.charts import Line, chart, colored_map, colors, legible, outline
from myowarp.osim.convert.report.data import alike, left_out
from myowarp.osim.convert.report.dynamics import dynamics_section, engines_table
from myowarp.osim.convert.report.verdict import verdict_section

if TYPE_CHECKING:
    from myowarp.osim.convert.tendon.fits import Samples
    from myowarp.osim.convert.tendon.fitted import Fits, MuscleFit

MAIN = 3
"""Coordinates of a muscle whose moment arms are drawn, greatest first."""
WORST = 1e-3
"""[m] of moment arm error with the strongest color."""
LEAST_DIFFERENCE = 0.05
"""[max_isometric_force] of difference with the strongest color, at least."""
VIEWS = (("from the right", 0, 1.0), ("from the left", 0, -1.0), ("from the front", 1, 1.0))
"""Title, axis of the world that points across, and its sign; z is up."""
INKS = f":root {{ --ours: {BLUE}; --theirs: {ORANGE}; --good: {GREEN}; --bad: {RED}; --xml: {VERMILION} }}"
STYLE = """
body { font: 14px/1.45 system-ui, sans-serif; color: #1d2129; max-width: 1180px; margin: 2rem auto;
 padding: 0 1rem }
h1 { font-size: 1.5rem; margin-bottom: .2rem } h2 { font-size: 1.15rem; margin: 2.2rem 0 .4rem }
h3 { font-size: 1rem; margin: 1.4rem 0 0 } p { max-width: 60rem; margin: .2rem 0 .5rem }
table { border-collapse: collapse; font-size: 12px; font-variant-numeric: tabular-nums }
th, td { padding: .15rem .5rem; text-align: right; border-bottom: 1px solid #e8eaed } th { font-weight: 600 }
th:first-child, td:first-child, td.text, th.text { text-align: left } .wide { overflow-x: auto }
th.across { writing-mode: vertical-rl; transform: rotate(180deg); text-align: left; padding: .4rem .15rem }
.good { color: var(--good) } .bad { color: var(--bad); font-weight: 600 } .note { color: #5f6670 }
.legend span { margin-right: 1.4rem }
svg { vertical-align: top; font: 9.5px system-ui, sans-serif; fill: #4a4f57 }
svg .title { font-size: 11px; font-weight: 600; fill: #1d2129 }
svg polyline { fill: none; stroke-linejoin: round }
svg .x { text-anchor: middle } svg .y { text-anchor: end } svg .axis { fill: none; stroke: #9aa0a8 }
svg .axis text { fill: #4a4f57; stroke: none } .reference { stroke: var(--theirs); stroke-width: 5 }
.slope { stroke: #4a4f57; stroke-width: 1; stroke-dasharray: 2 2 }
.own { stroke: var(--ours); stroke-width: 1.5 }
.step { stroke: var(--ours); stroke-width: 1.5 } .xml { stroke: var(--xml); stroke-width: 1.2 }
.mjb { stroke: var(--good); stroke-width: 1.5; stroke-dasharray: 5 2 }
.step-key { color: var(--ours) } .mjb-key { color: var(--good) } .xml-key { color: var(--xml) }
.edge { stroke: #9aa0a8; stroke-width: 11; stroke-linecap: round }
.bone { stroke: #eceef1; stroke-width: 9; stroke-linecap: round }
.tendon { stroke-width: 1.6; stroke-linecap: round } .joint { fill: #4a4f57 }
pre { white-space: pre-wrap; font: inherit } a { color: inherit }
"""
MARKS = {True: ("good", "within"), False: ("bad", "beyond")}
KEYS = (("reference", "OpenSim"), ("slope", "OpenSim, minus slope of the length"), ("own", "converted"))
"""Classes of lines, and what they are."""
SAMPLE = '<svg width="30" height="10"><polyline class="{}" points="0,5 30,5"/></svg>'


def page(
    report: Mapping[str, Any],
    converted: Converted,
    model: mujoco.MjModel,
    fits: "Fits",
    samples: "Samples | None",
    dynamics: Dynamics,
) -> str:
    """Return the page of a conversion; `report` is the content of report.json."""
    title = escape(f"{report['name']}: OpenSim to MuJoCo")
    parts = [
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>'
        f"<style>{INKS}{STYLE}</style>",
        f"<h1>{title}</h1>",
        f'<p class="note">{escape(report["source"])}, document {report["document"]}, sha256 '
        f"{report['sha256'][:16]}; {escape(_counts(report['counts']))}.</p>",
        verdict_section(report["judge"]),
        _left_out(report),
        f"<h2>Accelerations</h2>{engines_table(report)}",
        _gates(report),
        f"<h2>Default pose</h2>{_pictures(converted, model)}",
        dynamics_section(report, dynamics),
    ]
    if samples is not None:
        parts += [_heat(report), _muscles(converted, model, fits.muscles, samples, report)]
    parts.append(_notes(report["notes"]))
    for name in ("credits", "publications"):
        if report[name]:
            parts.append(f"<h2>{name.capitalize()}</h2><pre>{escape(report[name])}</pre>")
    return "".join([*parts, "</html>\n"])


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{number} {name}" for name, number in counts.items())


def _left_out(report: Mapping[str, Any]) -> str:
    """Return what acts in OpenSim and not here."""
    rows = "".join(
        f'<tr><td class="bad">{escape(code)}</td><td class="text">{escape(said)}</td>'
        f'<td class="text">{escape(rules)}</td><td class="text">{escape(paths)}</td></tr>'
        for code, said, rules, paths in left_out(report["left_out"])
    )
    if not rows:
        return '<h2>Left out</h2><p class="good">Nothing that acts in OpenSim was left out.</p>'
    head = "<tr><th>code</th>" + "".join(f'<th class="text">{name}</th>' for name in LEFT_OUT) + "</tr>"
    return (
        "<h2>Left out</h2><p>This acts in OpenSim and not, or not as there, in the converted model. Greatest "
        f"forces are those in random poses at rest.</p><table>{head}{rows}</table>"
    )


def _gates(report: Mapping[str, Any]) -> str:
    """Return the table of figures with their gates, and of the figures without."""
    rows = []
    for gate in report["gates"]:
        unit, (style, word) = escape(gate["unit"]), MARKS[gate["passed"]]
        value = "no number" if gate["value"] is None else f"{gate['value']:.3g} {unit}"
        rows.append(
            f"<tr><td>{escape(gate['name'])}</td><td>{value}</td><td>{gate['bound']:g} {unit}</td>"
            f'<td class="{style}">{word}</td><td class="text">{escape(gate["where"])}</td></tr>'
        )
    head = '<tr><th>figure</th><th>value</th><th>gate</th><th></th><th class="text">where</th></tr>'
    table = f"<table>{head}{''.join(rows)}</table>"
    rows = []
    for group, figures in (("moment_arms", ARMS), ("muscles", MUSCLES)):
        for name, (said, factor, unit) in figures.items():
            if name in (summary := report[group]["summary"]):
                shown = (_number(summary[name][key], factor) for key in ("mean", "median", "max"))
                cells = "".join(f"<td>{cell}</td>" for cell in shown)
                rows.append(f"<tr><td>{escape(said)} [{unit}]</td>{cells}</tr>")
    if rows:
        head = "<tr><th>muscles, or muscles and coordinates</th><th>mean</th><th>median</th><th>max</th></tr>"
        poses, arms = report["muscles"]["poses"], report["moment_arms"]
        table += (
            f"<h2>Muscles in {poses} held-out random poses</h2><p>Every coordinate varies over its full "
            f"range. Reference: {escape(arms['reference'])}; {escape(report['muscles']['reference'])}; "
            f"frames: {escape(report['kinematics']['reference'])}. Where OpenSim's moment arm differs from "
            "minus the slope of its own length by more than 0.1 mm, the slope is the reference. Samples are "
            "left out where a length jumps or the reference has no number. Forces in % of the maximum "
            f"isometric force.</p><table>{head}{''.join(rows)}</table>{_worst(report)}"
        )
    return f"<h2>Checks</h2>{table}"


def _number(value: float | None, factor: float) -> str:
    return "no number" if value is None else f"{factor * value:.3g}"


def _worst(report: Mapping[str, Any]) -> str:
    """Return the muscles with the greatest errors at their own length, with their worst coordinate."""
    pairs: dict[str, list[Any]] = {}
    for pair in report["moment_arms"]["pairs"]:
        pairs.setdefault(pair["muscle"], []).append(pair)

    def size(value: float | None) -> float:
        return np.inf if value is None else value

    def rank(muscle: Mapping[str, Any]) -> float:
        return max(size(muscle["length"]["rms"]) / 3e-3, size(muscle["force_in_pose"]["rms"]) / 0.1)

    rows = []
    for muscle in sorted(report["muscles"]["each"], key=rank, reverse=True)[:WORST_MUSCLES]:
        own = pairs.get(muscle["muscle"], [])
        pair = max(own, key=lambda pair: size(pair["error"]["rms"]), default=None)
        arm = "" if pair is None else f"{_number(pair['error']['rms'], 1e3)} ({escape(pair['coordinate'])})"
        figures = [(muscle["length"][key], 1e3) for key in ("rms", "p95")]
        figures += [(muscle["force_in_pose"][key], 100) for key in ("rms", "p95")]
        cells = "".join(f"<td>{_number(*figure)}</td>" for figure in figures)
        name = escape(muscle["muscle"])
        rows.append(f'<tr><td><a href="#{name}">{name}</a></td>{cells}<td class="text">{arm}</td></tr>')
    if not rows:
        return ""
    heads = (
        "length RMS [mm]",
        "95th percentile",
        "force RMS [%]",
        "95th percentile",
        "worst moment arm [mm]",
    )
    head = "".join(f"<th>{name}</th>" for name in heads)
    return f"<h3>Worst muscles</h3><table><tr><th></th>{head}</tr>{''.join(rows)}</table>"


ARMS = {
    "rms": ("moment arm, RMS", 1e3, "mm"),
    "p95": ("moment arm, 95th percentile", 1e3, "mm"),
    "worst": ("moment arm, greatest error", 1e3, "mm"),
    "rms_consistent": ("moment arm, RMS where OpenSim agrees with itself", 1e3, "mm"),
    "rms_computed": ("moment arm, RMS against OpenSim's own everywhere", 1e3, "mm"),
    "wrong_signs": ("moment arm, wrong signs above 1 mm", 100, "%"),
    "inconsistent": ("samples judged by the slope of the length", 100, "%"),
    "excluded": ("samples left out", 100, "%"),
}
"""Figures of `report.data.ARM_FIGURES`: what they are, factor, unit."""
MUSCLES = {
    "length": ("length, RMS", 1e3, "mm"),
    "length_worst": ("length, greatest error", 1e3, "mm"),
    "force": ("force at OpenSim's length, RMS", 100, "%"),
    "force_full": ("force at OpenSim's length, full activation, RMS", 100, "%"),
    "force_in_pose": ("force at the converted path's length, RMS", 100, "%"),
    "force_in_pose_p95": ("force at the converted path's length, 95th percentile", 100, "%"),
    "force_in_pose_worst": ("force at the converted path's length, greatest error", 100, "%"),
}
"""Of `report.data.MUSCLE_FIGURES`."""
WORST_MUSCLES = 6
LEFT_OUT = ("number, effect, greatest force", "what was done", "where")
"""Columns beside the code."""


def _pictures(converted: Converted, model: mujoco.MjModel) -> str:
    """Draw bodies as capsules from joint to joint, and tendons in their colors, from three sides."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    found = [ends for _, ends in bones(converted.model, converted.bodies, model)]
    strokes = [("bone", ends) for ends in found]
    wraps = data.wrap_xpos.reshape(-1, 3)
    for tendon, (first, count) in enumerate(zip(data.ten_wrapadr, data.ten_wrapnum, strict=True)):
        red, green, blue = (255 * model.tendon_rgba[tendon, :3]).astype(int)
        strokes += [
            (f"tendon:rgb({red},{green},{blue})", piece) for piece in _pieces(wraps[first : first + count])
        ]
    if not strokes:
        return "<p>Nothing moves.</p>"
    dots = np.array([ends[0] for ends in found]).reshape(-1, 3)
    pictures = []
    for title, axis, sign in VIEWS:
        right, up = np.eye(3)[axis] * sign, np.array([0.0, 0.0, 1.0])
        away = np.cross(up, right)
        nearest = sorted(strokes, key=lambda stroke: -float(np.mean(stroke[1] @ away)))
        turn = np.array([right, up]).T
        pictures.append(outline(title, [(style, line @ turn) for style, line in nearest], dots @ turn))
    return f'<div class="wide">{"".join(pictures)}</div>'


def _pieces(points: np.ndarray) -> list[np.ndarray]:
    """Return the straight pieces of a tendon, so that what is nearer can cover what is farther."""
    return [points[index : index + 2] for index in range(len(points) - 1)]


def _heat(report: Mapping[str, Any]) -> str:
    """Return the table muscle x coordinate of moment arm errors."""
    pairs = {(pair["muscle"], pair["coordinate"]): pair for pair in report["moment_arms"]["pairs"]}
    drawn = {muscle["muscle"] for muscle in report["muscles"]["each"]}
    muscles, coordinates = (list(dict.fromkeys(key[i] for key in pairs)) for i in (0, 1))
    rows = []
    for muscle in muscles:
        cells = []
        for coordinate in coordinates:
            pair = pairs.get((muscle, coordinate))
            if pair is None:
                cells.append("<td></td>")
                continue
            error = pair["error"]["rms"]
            color = colors(np.array(1.0 if error is None else 0.8 * error / WORST), signed=False)
            tip = f"{muscle}, {coordinate}: at most {_number(pair['error']['worst'], 1e3)} mm, "
            tip += f"{100 * pair['inconsistent']:.0f} % judged by the slope, "
            tip += f"{100 * pair['excluded']:.0f} % left out, "
            tip += f"greatest moment arm {_number(pair['peak'], 1e3)} mm"
            shown = "–" if error is None else f"{1e3 * error:.2f}"
            cells.append(f'<td style="{legible(color)}" title="{escape(tip)}">{shown}</td>')
        shown = escape(muscle)
        if muscle in drawn:
            shown = f'<a href="#{shown}">{shown}</a>'
        rows.append(f"<tr><td>{shown}</td>{''.join(cells)}</tr>")
    heads = "".join(f'<th class="across">{escape(name)}</th>' for name in coordinates)
    return (
        "<h2>Moment arm errors [mm]</h2>"
        "<p>Root mean square; empty: no moment arm.</p>"
        f'<div class="wide"><table><tr><th></th>{heads}</tr>{"".join(rows)}</table></div>'
    )


def _muscles(
    converted: Converted,
    model: mujoco.MjModel,
    fits: "Sequence[MuscleFit]",
    samples: "Samples",
    report: Mapping[str, Any],
) -> str:
    """Return the curves and maps of all muscles."""
    from myowarp.osim.convert.check.muscles import motion

    free = converted.coordinates.free()
    arms = {
        name: motion(converted, model, poses).moment_arm[:, :, free.index(name)]
        for name, poses in samples.sweeps.items()
    }
    figures = {muscle["muscle"]: muscle for muscle in report["muscles"]["each"]}
    sections = []
    for fit in fits:
        sweeps, charts = fit.expected.sweeps, []
        peak = {name: float(np.abs(sweeps[name].moment_arm[name]).max()) for name in sweeps}
        for name in sorted(peak, key=lambda name: -peak[name])[:MAIN]:
            own = arms[name][:, model.tendon(fit.name).id]
            charts.append(_curve(converted, name, samples, sweeps[name], own))
        figure = figures[fit.name]
        said = f"length {_number(figure['length']['rms'], 1e3)} mm, "
        said += f"force {_number(figure['force_in_pose']['rms'], 100)} % RMS"
        sections.append(
            f'<h3 id="{escape(fit.name)}">{escape(fit.name)} <small class="note">{said}</small></h3>'
            f'<div class="wide">{"".join(charts)}</div><div class="wide">{_maps(fit)}</div>'
        )
    intro = (
        "Moment arms over the range of a coordinate, the others at their defaults; forces at rest over "
        "length and activation, in maximum isometric forces."
    )
    legend = "".join(f"<span>{SAMPLE.format(style)} {text}</span>" for style, text in KEYS)
    intro = f'<p>{intro}</p><p class="legend">{legend}</p>'
    return f"<h2>Muscles</h2>{intro}{''.join(sections)}"


def _curve(converted: Converted, name: str, samples: "Samples", reference: Any, own: np.ndarray) -> str:
    """Return the chart of the moment arms along one coordinate."""
    rotational = converted.model.coordinates[name].rotational
    x = samples.sweeps[name].coordinates[name] * (180 / np.pi if rotational else 1.0)
    lines = [
        Line(x, 1e3 * reference.moment_arm[name], "reference"),
        Line(x, 1e3 * reference.slope[name], "slope"),
        Line(x, 1e3 * own, "own"),
    ]
    # Where a path jumps, its slope is a spike that would squeeze all else.
    reach = 1.5 * max(float(np.abs(np.concatenate([lines[0].y, lines[2].y])).max()), 0.1)
    lines[1] = Line(x, np.where(np.abs(lines[1].y) > reach, np.nan, lines[1].y), "slope")
    return chart(f"{name} [mm]", "°" if rotational else "m", lines)


def _maps(fit: "MuscleFit") -> str:
    """Return force over length and activation: as lines, and the maps of reference, fit and difference."""
    from myowarp.osim.convert.check.muscles import engine_force

    x, reference = 1e3 * fit.expected.grid, fit.expected.map
    own = engine_force(fit, fit.expected.grid)
    lines = [Line(x, column, "reference") for column in reference.T]
    lines += [Line(x, column, "own") for column in own.T]
    parts = [chart("force", "length [mm]", lines)]
    top = max(float(reference.max()), float(own.max()), 1e-6)
    worst = max(float(np.abs(own - reference).max()), LEAST_DIFFERENCE)
    ends = float(x[0]), max(float(x[-1]), float(x[0]) + 1e-6)
    for title, values, unit in (
        (f"OpenSim, 0 to {top:.2g}", reference, top),
        (f"converted, 0 to {top:.2g}", own, top),
        (f"difference, ±{worst:.2g}", own - reference, worst),
    ):
        parts.append(colored_map(title, "length [mm]", ends, (0.0, 1.0), "activation", values, unit))
    return "".join(parts)


def _notes(notes: list[dict[str, Any]]) -> str:
    """Return what is not carried over exactly: a line for what is alike, which opens to its elements."""
    parts = []
    for done, group in alike(notes).items():
        rows = "".join(
            f'<tr><td class="text">{escape(note["path"])}</td>'
            f'<td class="text">{escape(note["rule"].partition(":")[2])}</td>'
            f'<td class="text">{escape(note["error_bound"] or "")}</td></tr>'
            for note in group
        )
        table = f'<table><tr><th>where</th><th></th><th class="text">error at most</th></tr>{rows}</table>'
        parts.append(f"<details><summary>{len(group)} × {escape(done)}</summary>{table}</details>")
    return f"<h2>Not exact: {len(notes)} elements</h2>{''.join(parts)}"
