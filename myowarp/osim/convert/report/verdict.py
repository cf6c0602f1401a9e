"""The verdict of a report: what a model is good for, and joint torques and lengths three ways."""

from collections.abc import Mapping
from html import escape
from typing import Any

HEADS = ("OpenSim's paths in MyoWarp", "fitted tendons in MyoWarp", "plain MuJoCo")


def verdict_section(judged: Mapping[str, Any]) -> str:
    """Return the section; `judged` is `judge` of report.json, empty without fits."""
    if not judged or not judged["muscles"]:
        return ""
    said = "".join(f"<p>{escape(sentence)}</p>" for sentence in judged["verdict"])
    return f"<h2>Verdict</h2>{said}{_torques(judged['torques'])}{_muscles(judged['muscles'])}"


def _torques(torques: list[Mapping[str, Any]]) -> str:
    rows = []
    for torque in sorted(torques, key=lambda one: -_sort(one["plain"]["rms"])):
        cells = "".join(
            f"<td>{_figure(torque[way]['rms'], 100)}; {_figure(torque[way]['worst'], 100)}</td>"
            for way in ("own", "tendon", "plain")
        )
        rest = f"<td>{torque['greatest']:.3g}</td><td>{torque['poses']}</td>"
        rows.append(f'<tr><td class="text">{escape(torque["coordinate"])}</td>{cells}{rest}</tr>')
    if not rows:
        return ""
    heads = "".join(f"<th>{name} [%]</th>" for name in HEADS)
    heads += "<th>greatest torque [N m, N]</th><th>poses</th>"
    return (
        "<h3>Joint torque of all muscles</h3><p>Static, at five activations, judged by OpenSim's "
        "computeMomentArm: root mean square of the error over that of the reference; greatest error over the "
        "greatest torque. The first two columns have the file's muscles, the third MuJoCo's.</p>"
        f'<table><tr><th class="text">coordinate</th>{heads}</tr>'
        f"{''.join(rows)}</table>"
    )


def _muscles(muscles: list[Mapping[str, Any]]) -> str:
    rows = []
    for one in sorted(muscles, key=lambda muscle: -_sort(muscle["tendon"]["far"])):
        cells = "".join(
            f"<td>{_figure(one[way]['median'], 1e3)}; {_figure(one[way]['worst'], 1e3)}</td>"
            f"<td>{_figure(one[way]['far'], 100)}; {_figure(one[way]['strong'], 100)}</td>"
            for way in ("own", "tendon")
        )
        cells += f"<td>{_figure(one['far_side'], 100)}; {_figure(one['unbent'], 100)}</td>"
        rows.append(f'<tr><td class="text">{escape(one["muscle"])}</td>{cells}<td>{one["jumps"]}</td></tr>')
    heads = "".join(
        f"<th>{way}: median; worst [mm]</th><th>poses beyond 2 mm; 5 % [%]</th>"
        for way in ("OpenSim's path", "fitted tendon")
    )
    heads += "<th>fitted tendon on the far side; straight where OpenSim's path bends [%]</th><th>jumps</th>"
    return (
        "<h3>Lengths of muscles</h3><p>5 %: of the maximum isometric force, static, at any of five "
        "activations, with the file's muscle. Poses in which OpenSim's own path jumps, or has no length, are "
        f'counted and left out.</p><table><tr><th class="text">muscle</th>{heads}</tr>{"".join(rows)}</table>'
    )


def _sort(value: float | None) -> float:
    """Return what to sort by: what is no number comes first."""
    return float("inf") if value is None else value


def _figure(value: float | None, factor: float) -> str:
    return "no number" if value is None else f"{factor * value:.2g}"
