"""Audits as one page that needs nothing else: a table, then a row of plots for each id."""

import base64
import re
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from myowarp.apps.reports import panel
from myowarp.apps.studies.audit.figures import FIGURES, changes, findings
from myowarp.apps.studies.audit.measure import Audit
from myowarp.inks import BLUE, RED, SKY, VERMILION

COLORS = {"zero": "#8a8f98", "random": BLUE, "extreme": VERMILION}
BLOCKS = (BLUE, SKY)  # neighbouring observation blocks
SIZE = (15.0, 2.5)  # inches, one id
BINS = 24
SPACING = 0.042  # smallest distance of the labels of blocks, of the width
SHORTER: tuple[tuple[re.Pattern[str], Any], ...] = (
    (re.compile(r' (?:d|x|y|transform)="[^"]*"'), lambda found: re.sub(r"(\.\d)\d+", r"\1", found[0])),
    (re.compile(r"font-family: [^;\"]*"), "font-family: sans-serif"),
    (re.compile(r"\s*\n\s*"), "\n"),
)
"""Makes an SVG of matplotlib's a third smaller: coordinates to a tenth of a point, one font, no indents."""
NEVER = " (never fires)"
TEMPLATE = Path(__file__).with_suffix(".html")


class Page:
    """A page that grows audit by audit."""

    def __init__(self) -> None:
        self._audits: list[Audit] = []
        self._pictures: dict[str, str] = {}

    def add(self, audit: Audit) -> None:
        """Add an audit and draw it."""
        self._audits.append(audit)
        picture = draw(audit, "svg").decode()
        for pattern, shorter in SHORTER:
            picture = pattern.sub(shorter, picture)
        self._pictures[audit.id] = base64.b64encode(picture.encode()).decode()

    def html(self) -> str:
        """Return the page as it is now."""
        upstream = {audit.id: audit for audit in self._audits if not audit.corrected}
        rows, sections, before = [], [], ""
        for audit in self._audits:
            there, first = upstream.get(audit.upstream), audit.name != before
            rows.append(_row(audit, there, first))
            if first:
                sections.append(f"<h2>{escape(_short(audit.name))}</h2>")
            sections.append(_section(audit, there, self._pictures[audit.id]))
            before = audit.name
        heads = "".join(f'<th title="{escape(f.meaning)}">{escape(f.head)}</th>' for f in FIGURES)
        meanings = "".join(f"<li><b>{escape(f.head)}</b> {escape(f.meaning)}</li>" for f in FIGURES)
        return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
            number=len(self._audits),
            settings=_settings(self._audits),
            heads=heads,
            rows="".join(rows),
            meanings=meanings,
            sections="".join(sections),
        )


def _short(env_id: str) -> str:
    """Return an id without its namespace."""
    return env_id.removeprefix("MyoWarp/")


def _settings(audits: list[Audit]) -> str:
    """Return how the audits were made."""
    if not audits:
        return ""
    one = audits[0]
    return escape(
        f"{', '.join(one.scores)} actions, {one.num_worlds} worlds, seed {one.seed}, physics {one.physics}, "
        f"on {one.device}; at least one horizon of each policy."
    )


def _row(audit: Audit, upstream: Audit | None, first: bool) -> str:
    """Return a row of the table."""
    changed = {figure.head: there for figure, there, _ in changes(audit, upstream)}
    cells = [f'<td><a href="#{escape(_short(audit.id))}">{escape(_short(audit.id))}</a></td>']
    for figure in FIGURES:
        marks = [
            name for name, on in (("bad", figure.is_bad(audit)), ("changed", figure.head in changed)) if on
        ]
        old = f"<small>{escape(changed[figure.head])}</small>" if figure.head in changed else ""
        cells.append(f'<td class="{" ".join(marks)}">{escape(figure.text(audit))}{old}</td>')
    marks = [name for name, on in (("first", first), ("corrected", audit.corrected)) if on]
    return f'<tr class="{" ".join(marks)}">{"".join(cells)}</tr>'


def _section(audit: Audit, upstream: Audit | None, picture: str) -> str:
    """Return what there is to say about an id, and its plots."""
    short = escape(_short(audit.id))
    parts = [f'<h3 id="{short}">{short}</h3><p>{escape(audit.doc)}</p>']
    if against := [f"{f.name} {old} → {new}{f.unit}" for f, old, new in changes(audit, upstream)]:
        parts.append(f"<p><b>Against {escape(_short(audit.upstream))}:</b> {escape('; '.join(against))}.</p>")
    if found := findings(audit):
        parts.append(f'<ul class="bad">{"".join(f"<li>{escape(text)}</li>" for text in found)}</ul>')
    rule = audit.targets.why or audit.targets.rule
    parts.append(f'<p class="note">Targets: {escape(rule)}. Reset: {escape(audit.reset)}.</p>')
    parts.append(f'<img alt="plots of {short}" src="data:image/svg+xml;base64,{picture}">')
    return "".join(parts)


def draw(audit: Audit, form: str) -> bytes:
    """Return the row of plots of an audit as a picture in a format of matplotlib's, such as svg or png."""
    with panel.style(8.0, **{"axes.titleweight": "bold", "axes.grid": False}):
        figure = panel.blank(*SIZE)
        widths = {"width_ratios": (1.0, 0.9, 1.3, 1.9)}
        returns, alive, terms, columns = figure.subplots(1, 4, gridspec_kw=widths)
        _draw_returns(returns, audit)
        _draw_alive(alive, audit)
        _draw_terms(terms, audit)
        _draw_columns(columns, audit)
        return panel.picture(figure, form)


def _draw_returns(axes: Axes, audit: Audit) -> None:
    """Histogram of the returns of each policy."""
    every = np.concatenate([score.returns for score in audit.scores.values()])
    axes.set_title("returns")
    axes.set_xlabel("return")
    axes.set_ylabel("episodes")
    if not len(every):
        return
    low, high = every.min(), every.max()
    margin = max(high - low, 1e-3 * abs(high), 1e-6) / BINS
    edges = np.linspace(low - margin, high + margin, BINS + 1)
    for name, score in audit.scores.items():
        counts, _ = np.histogram(score.returns, edges)
        axes.stairs(counts, edges, color=COLORS[name], alpha=0.25, fill=True)
        axes.stairs(counts, edges, color=COLORS[name], label=name)
    axes.legend()


def _draw_alive(axes: Axes, audit: Audit) -> None:
    """Share of the episodes that have not failed yet, step by step."""
    axes.set_title("not failed yet")
    axes.set_xlabel("control step")
    axes.set_ylabel("% of episodes")
    for name, score in audit.scores.items():
        if score.episodes:
            gone = np.cumsum([0, *score.failures]) / score.episodes
            axes.step(
                np.arange(len(gone)), 100.0 * (1.0 - gone), where="post", color=COLORS[name], label=name
            )
    axes.set_ylim(-3.0, 103.0)
    axes.set_xlim(0.0, audit.horizon)


def _draw_terms(axes: Axes, audit: Audit) -> None:
    """Draw the average share of each weighted term in the reward of a step."""
    terms = [term for term in audit.terms if term.weight != 0.0]
    places, height = np.arange(len(terms)), 0.8 / len(audit.scores)
    for i, name in enumerate(audit.scores):
        shares = [term.weight * term.means[name] for term in terms]
        bars = axes.barh(places + (i - 1) * height, shares, height, color=COLORS[name])
        axes.bar_label(bars, [f"{share:.2g}" if share else "" for share in shares], fontsize=6, padding=2)
    silent = [term.name in audit.silent_terms for term in terms]
    names = [f"{term.name}{NEVER * never}" for term, never in zip(terms, silent, strict=True)]
    axes.set_yticks(places, names)
    for label, never in zip(axes.get_yticklabels(), silent, strict=True):
        label.set_color(RED if never else "black")
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.axvline(0.0, color="black", linewidth=0.6)
    axes.set_title("weighted terms, mean per step")
    axes.set_xlabel("reward")


def _draw_columns(axes: Axes, audit: Audit) -> None:
    """Range of every observation column, block by block."""
    blocks: dict[str, list[int]] = {}
    for i, column in enumerate(audit.columns):
        blocks.setdefault(column.name.rpartition("[")[0], []).append(i)
    low, high = (np.array([getattr(column, end) for column in audit.columns]) for end in ("low", "high"))
    for k, entries in enumerate(blocks.values()):
        gap = np.full(len(entries), np.nan)  # one line with gaps: a third of the size of many lines
        across = np.column_stack([entries, entries, gap]).ravel()
        ends = np.column_stack([low[entries], high[entries], gap]).ravel()
        axes.plot(across, ends, color=BLOCKS[k % 2], linewidth=2.2, solid_capstyle="butt")
    still = np.flatnonzero(low == high)
    axes.plot(still, low[still], "x", color=RED, markersize=4)
    axes.axhline(0.0, color="black", linewidth=0.6)
    axes.set_yscale("symlog", linthresh=0.1)
    style: Any = {"rotation": 40, "ha": "right", "rotation_mode": "anchor", "fontsize": 7}
    places = [float(np.mean(entries)) for entries in blocks.values()]
    for k in range(1, len(places)):
        places[k] = max(places[k], places[k - 1] + SPACING * len(audit.columns))
    axes.set_xticks(places, list(blocks), **style)
    axes.set_xlim(-1.0, len(audit.columns))
    axes.set_title("observation ranges" + (", x: constant" if len(still) else ""))
