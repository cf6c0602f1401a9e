"""The result of `describe` as text for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Any

from myowarp.definitions.entries import axes

INDENT = "  "
FEW = 3  # names that stand on the line of their block
LEAST_TEXT = 28  # characters that the last column has at least
NOT_SAID = "(the task does not say)"


def as_text(facts: dict[str, Any], width: int = 80) -> str:
    """Return a description as text.

    Args:
        facts: What `describe` returned.
        width: Longest line, where words allow it.
    """
    return "\n\n".join(f"{title}\n{text}" for title, text in sections(facts, width).items())


def sections(facts: dict[str, Any], width: int = 80) -> dict[str, str]:
    """Return a description as texts by title; see `as_text`."""
    lines = {
        facts["id"]: _about(facts),
        f"Observation: {facts['observation']['size']} numbers": _observation(facts["observation"]),
        f"Action: {facts['action']['size']} numbers, -1 to 1": _action(facts["action"]),
        "Reward": _reward(facts["reward"]),
        "Success and failure": _endings(facts),
        "Resets": _resets(facts),
        f"Body: {facts['body']['name']}": _body(facts["body"]),
    }
    if facts["muscles"]["muscles"]:
        lines[f"Muscles: {len(facts['muscles']['muscles'])}"] = _muscles(facts["muscles"])
    if facts["conditions"]:
        lines["Conditions"] = _conditions(facts["conditions"])
    return {
        title: "\n".join(wrapped for line in own for wrapped in _wrapped(line, width))
        for title, own in lines.items()
    }


def _wrapped(line: str, width: int) -> list[str]:
    """Return a line in pieces of at most `width`; they go on where the last of its columns begins.

    Columns are three or more spaces apart.
    """
    begin = line.rfind("   ")
    hang = min(begin + 3 if begin >= 0 else 0, max(width - LEAST_TEXT, 0))
    return textwrap.wrap(
        line,
        width,
        initial_indent=INDENT,
        subsequent_indent=INDENT + " " * hang,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )


def number(value: float) -> str:
    """Return a number with four digits at most."""
    return f"{value + 0.0:.4g}"  # no minus before 0


def _rows(rows: Iterable[Iterable[str]]) -> list[str]:
    """Return rows as lines with columns of equal width, three spaces apart."""
    table = [list(row) for row in rows]
    if not table:
        return []
    widths = [max(map(len, column)) for column in list(zip(*table, strict=True))[:-1]]
    return [
        "   ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]])
        for row in table
    ]


def _about(facts: dict[str, Any]) -> Iterator[str]:
    """Say what the task asks for, how long, and what its versions are."""
    yield facts["summary"]
    if facts["why"]:
        yield facts["why"]
    if facts["task"] != facts["id"]:
        yield f"The task is {facts['task']}."
    for version in facts["versions"]:
        yield f"Other version {version['id']}: " + (version["why"] or "without these changes.")
    episode = facts["episode"]
    yield (
        f"An episode has {episode['horizon']} control steps of {number(episode['control_dt'])} s, "
        f"{number(episode['seconds'])} s."
    )
    for name, physics in episode["physics"].items():
        yield (
            f"Physics {name}: {physics['steps']} steps of {number(1000 * physics['dt'])} ms in a control "
            f"step, integrator {physics['integrator']}."
        )


def _observation(observation: dict[str, Any]) -> list[str]:
    """Say what each number of the observation is."""
    heads, below = [("index", "block", "unit", "meaning")], [""]
    listed: dict[tuple[str, ...], str] = {}
    for block in observation["blocks"]:
        names = tuple(entry["name"] for entry in block["entries"])
        said = block["doc"] or NOT_SAID
        more = ""
        if len(names) <= FEW:
            said += f": {_names(names)}"
        else:
            first = listed.setdefault(names, block["name"])
            more = _names(names) if first == block["name"] else f"in the order of {first}"
        heads.append((_index(block["first"], block["last"]), block["name"], block["unit"], said))
        below.append(more)
    rows = _rows(heads)
    indent = " " * rows[0].find("block")
    pairs = [(row, f"{indent}   {more}" if more else "") for row, more in zip(rows, below, strict=True)]
    return [line for pair in pairs for line in pair if line]


def _index(first: int, last: int) -> str:
    """Return a range of indices."""
    return str(first) if first == last else f"{first}-{last}"


def _names(names: tuple[str, ...]) -> str:
    """Return names in a list; those of points only once."""
    points = [name.removesuffix(" x") for name in names[::3]]
    if names == axes(points):
        return f"x, y, z of {', '.join(points)}"
    return ", ".join(names)


def _action(action: dict[str, Any]) -> Iterator[str]:
    """Say what each action does."""
    yield f"Policies may return any finite number: {action['limits']}."
    if "muscle" in action["maps"]:
        law = action["maps"]["muscle"]
        at = ", ".join(f"{value:.3f} at action {key}" for key, value in law["at"].items())
        yield f"Muscles: {law['law']}, which is {at}; action 0 is not rest."
    if "motor" in action["maps"]:
        yield f"Motors: {action['maps']['motor']['law']}."
    rows = []
    for _, group in groupby(action["actuators"], lambda row: row["name"] if row["kind"] == "motor" else ""):
        run = list(group)
        span = _index(run[0]["index"], run[-1]["index"])
        if run[0]["kind"] == "muscle":
            rows.append((span, f"excitation of {', '.join(row['name'] for row in run)}"))
        else:
            low, high, unit = number(run[0]["low"]), number(run[0]["high"]), run[0]["unit"]
            rows.append((span, f"motor {run[0]['name']}: {run[0]['quantity']}, {low} to {high} {unit}"))
    yield from _rows(rows)


def _reward(reward: dict[str, Any]) -> Iterator[str]:
    """Say what the reward is."""
    yield f"{reward['formula']}, in every step"
    rows = [("weight", "term", "unit", "meaning")]
    for term in reward["terms"]:
        weight = number(term["weight"]) if term["weight"] else "-"
        rows.append((weight, term["name"], term["unit"], term["doc"] or NOT_SAID))
    yield from _rows(rows)
    yield 'Each term is info["terms/<name>"], before its weight; a term with weight "-" is only shown there.'


def _endings(facts: dict[str, Any]) -> Iterator[str]:
    """Say when a task is solved, when an episode succeeds, and when it fails."""
    yield f"Solved: a state in which {facts['success']['solved'] or NOT_SAID}."
    yield f"Success: an episode in which {facts['success']['success']}; to pass through is enough."
    yield f"Failed: a state in which {facts['failure']['failed'] or NOT_SAID}; it ends the episode."
    yield f"Fault: {', '.join(facts['failure']['faults'])}; it ends the episode with reward 0."


def _resets(facts: dict[str, Any]) -> Iterator[str]:
    """Say what episodes start from, and what they draw."""
    resets = facts["resets"]
    yield f'This id resets as "{resets["own"]}"; the option `reset` chooses:'
    rows: list[tuple[str, ...]] = []
    for name, kind in resets["kinds"].items():
        draws = f"; draws {', '.join(kind['draws'])}" if kind["draws"] else ""
        rows.append((name, f"{kind['start']}{draws}"))
    yield from _rows(rows)
    yield 'Velocities and activations start at 0, except under "none".'
    for varies, title in (
        (True, "Drawn anew, uniformly unless it says otherwise:"),
        (False, "The same in every episode:"),
    ):
        rows = [(d["name"], f"{d['doc']}: {_bounds(d)}") for d in facts["draws"] if d["varies"] == varies]
        if rows:
            yield title
            yield from _rows(rows)


def _bounds(draw: dict[str, Any]) -> str:
    """Return the bounds of a draw, numbers with the same bounds together."""
    if "choices" in draw:
        *most, last = map(number, sorted(draw["choices"]))
        return f"{', '.join(most)} or {last}" if most else last
    texts = [(entry["name"], _span(entry["low"], entry["high"], entry["unit"])) for entry in draw["entries"]]
    if len({text for _, text in texts}) == 1:
        return texts[0][1] + ("" if len(texts) == 1 else f" ({', '.join(name for name, _ in texts)})")
    return ", ".join(f"{name} {text}" for name, text in texts)


def _span(low: float, high: float, unit: str) -> str:
    """Return a range with its unit."""
    unit = "" if unit == "1" else f" {unit}"
    return f"{number(low)}{unit}" if low == high else f"{number(low)} to {number(high)}{unit}"


def _body(body: dict[str, Any]) -> Iterator[str]:
    """Say what the body is."""
    if body["doc"]:
        yield f"{body['doc'][:1].upper()}{body['doc'][1:]}"
    rows = []
    for joint in body["joints"]:
        text = joint["type"]
        if joint.get("range"):
            low, high = joint["range"]
            text += f", {_span(low, high, joint['unit'])}"
        elif "unit" in joint:
            text += ", no range"
        rows.append((joint["name"], text + (f"; follows {joint['follows']}" if "follows" in joint else "")))
    yield f"Joints: {len(rows)}"
    yield from _rows(rows)
    yield f"Tips (sites): {', '.join(body['tips']) or 'none'}"


def _muscles(muscles: dict[str, Any]) -> Iterator[str]:
    """Say what the muscles are."""
    yield muscles["model"]
    units = muscles["units"]
    heads = [f"{name.replace('_', ' ')} [{unit}]" for name, unit in units.items()]
    if heads:
        yield f"Numbers: {', '.join(heads)}"
    rows = [
        (row["name"], *(number(row[key]) for key in units), row["group"] or "-") for row in muscles["muscles"]
    ]
    yield from _rows(rows)


def _conditions(given: list[dict[str, Any]]) -> Iterator[str]:
    """Say what the conditions are."""
    for condition in given:
        yield f"{condition['name']}: {condition['doc']}"
        yield from _rows([(f"{p['name']} = {p['value']}", p["doc"]) for p in condition["parameters"]])
        if condition["info"]:
            shown = ", ".join(f'info["{name}"]' for name in condition["info"])
            yield f"Shown in {shown}"
