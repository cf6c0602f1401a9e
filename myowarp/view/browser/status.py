"""The readings of a page as HTML: how far the episode is, its reward, and what the colours mean."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from myowarp.inks import BLUE, RED, SKY
from myowarp.kernels.episode import SUCCESS_RULE
from myowarp.sim.economy import as_text
from myowarp.view.browser.controls import Controls
from myowarp.view.browser.session import Session
from myowarp.view.drawing import style as look
from myowarp.view.drawing.muscles import Quantity

GOOD, BAD, BAR = BLUE, RED, SKY
BAR_WIDTH = 6.0
"""em of the longest bar of a reward term."""


def status(live: Controls) -> str:
    """Return time, return and success."""
    session = live.session
    state = "" if live.playing else "paused · "
    if live.back > 0.0:
        state = f"{live.back:.1f} s back · "
    length = session.sim.setup.episode_steps * session.sim.scene.control_dt
    earlier = session.episode - 1
    before = f", {session.succeeded} of {earlier} before succeeded" if session.scored and earlier else ""
    rows = [
        f"<b>{state}{session.time:.2f} s of {length:.4g} s</b>{_verdict(session)}",
        f"episode {session.episode}{before} · {live.factor:.2f} × real time",
    ]
    if walk := as_text(session.walk(session.world)):
        rows.append(f"{walk} since its start")
        if session.beside and (walk := as_text(session.walk(session.twin))):
            rows[-1] += f" · before the change {walk}"
    if session.scored:
        rows.append(f"return {session.returns[session.world]:.2f}")
        if session.beside:
            rows[-1] += f" · before the change {session.returns[session.twin]:.2f}"
    if live.message:
        rows.append(f"<span style='color:{BAD}'>{html.escape(live.message)}</span>")
    return block(rows)


def block(rows: Sequence[str]) -> str:
    """Return lines of readings, HTML."""
    return f"<div style='padding:0.5em 1em;font-size:0.85em'>{'<br>'.join(rows)}</div>"


def _verdict(session: Session) -> str:
    """Return whether the episode has failed, or counts as a success so far."""
    if not session.scored or not (session.failed or session.success):
        return ""
    text, color = ("failed", BAD) if session.failed else ("success so far", GOOD)
    return f" · <b style='color:{color}' title='{html.escape(SUCCESS_RULE)}'>{text}</b>"


def terms(session: Session) -> str:
    """Return reward terms of the last step with bars; "" where nobody has asked for a reward."""
    if not session.scored:
        return ""
    terms = session.terms
    largest = max((abs(value) for value in terms.values()), default=0.0) or 1.0
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td>"
        f"<td style='text-align:right;padding:0 0.7em'>{value:.3f}</td>"
        f"<td><div style='height:0.7em;width:{BAR_WIDTH * abs(value) / largest:.2f}em;"
        f"background:{BAR if value >= 0 else BAD}'></div></td></tr>"
        for name, value in terms.items()
    )
    return block([f"reward of the last step<table>{rows}</table>"])


def legend(quantity: Quantity) -> str:
    """Return the colours of a quantity with its name and its ends."""
    stops = ",".join(_css(rgb) for rgb in np.array(quantity.colors))
    return (
        "<div style='padding:0 1em 0.5em;font-size:0.8em'>"
        f"<div style='height:0.8em;border-radius:3px;background:linear-gradient(to right,{stops})'></div>"
        f"<div style='display:flex;justify-content:space-between'><span>{quantity.low:g}</span>"
        f"<span>{html.escape(quantity.label)}</span><span>{quantity.high:g}</span></div></div>"
    )


def key(tips: bool, targets: bool, ghost: bool, objects: Sequence[tuple[str, np.ndarray]]) -> str:
    """Return what the balls, the ghost and other bodies in the picture are."""
    rows = []
    if tips:
        rows.append((_css(look.TIP_RGB), "1", "point that the task steers"))
    if targets:
        rows.append((_css(look.TARGET_RGB), "1", "target"))
    if ghost:
        rows.append((_css(look.TARGET_RGB), "0.35", "wanted posture"))
    rows += [(_css(rgb), "1", name) for name, rgb in objects]
    parts = "".join(
        "<span style='margin-right:1em;white-space:nowrap'><span style='display:inline-block;width:0.8em;"
        f"height:0.8em;border-radius:50%;background:{color};opacity:{opacity}'></span> "
        f"{html.escape(text)}</span>"
        for color, opacity, text in rows
    )
    return f"<div style='padding:0 1em 0.5em;font-size:0.8em'>{parts}</div>"


def _css(rgb: np.ndarray) -> str:
    """Return a colour in 0..1 as CSS."""
    return f"rgb({','.join(f'{value:.0f}' for value in 255 * np.asarray(rgb))})"
