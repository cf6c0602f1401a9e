"""A page for each task family and id, written before the site is built: `myowarp describe`, audit, baseline.

A Sphinx extension; the pages go to docs/tasks/, which git ignores.
"""

import json
from itertools import groupby
from pathlib import Path
from typing import Any

import recordings
from sphinx.application import Sphinx
from sphinx.util.display import status_iterator

from myowarp.apps.policies import baselines
from myowarp.apps.reports.describe import describe
from myowarp.apps.reports.describe_text import sections
from myowarp.apps.reports.evaluation import success_text
from myowarp.definitions.task import TASKS
from myowarp.kernels.episode import MYOSUITE

DOCS = Path(__file__).parent
PAGES = DOCS / "tasks"
FOLDED = 60  # characters of names that a page folds
UNBROKEN = 100_000  # characters of a line that is not broken
WIDTH = 90  # characters that a page shows without scrolling at 1280 px


def page(key: str, audit: dict[str, Any] | None) -> str:
    """Return the page of a task id as Markdown."""
    spec = TASKS[key]
    description = describe(spec)
    facts = sections(description, WIDTH)
    del facts[spec.env_id]
    about = sections(description, UNBROKEN)[spec.env_id].splitlines()
    commands = f"myowarp view {key}\nmyowarp train {key} --output runs/task"
    picture = f"![{spec.family}, {spec.body}](../pictures/{spec.family}_{spec.body}.png)"
    parts = [f"# {key}", "\n\n".join(line.strip() for line in about), picture, f"```sh\n{commands}\n```"]
    if baseline := _baseline(key):
        parts.append(f"## Trained policy\n\n{baseline}")
    if audit:
        parts.append(f"## Measured\n\n{_measured(audit)}")
    tables = {"Observation": _observation(description), "Reward": _reward(description)}
    for heading, text in facts.items():
        body = tables.get(heading.partition(":")[0], f"```text\n{text}\n```")
        parts.append(f"## {heading}\n\n{body}")
    return "\n\n".join(parts) + "\n"


def _cell(text: str) -> str:
    """Return a text as it stands in a cell of a table."""
    return text.replace("|", "\\|")


def _observation(description: dict[str, Any]) -> str:
    """Return the blocks of the observation as a table, with the names of the numbers, folded if many."""
    lines = ["| index | block | unit | meaning | numbers |", "|---|---|---|---|---|"]
    for block in description["observation"]["blocks"]:
        names = ", ".join(entry["name"] for entry in block["entries"])
        if len(names) > FOLDED:
            names = f"<details><summary>{len(block['entries'])} names</summary>{names}</details>"
        first, last = block["first"], block["last"]
        index = f"{first}" if first == last else f"{first}–{last}"
        lines.append(f"| {index} | `{block['name']}` | {block['unit']} | {_cell(block['doc'])} | {names} |")
    return "\n".join(lines)


def _reward(description: dict[str, Any]) -> str:
    """Return the terms of the reward as a table."""
    reward = description["reward"]
    lines = ["| weight | term | unit | meaning |", "|---|---|---|---|"]
    for term in reward["terms"]:
        weight = f"{term['weight']:g}" if term["weight"] else "–"
        lines.append(f"| {weight} | `{term['name']}` | {term['unit']} | {_cell(term['doc'])} |")
    note = '`info["terms/<name>"]` has each term before its weight; one with weight "–" is only shown there.'
    return "\n".join([f"`{reward['formula']}`, in every step", "", *lines, "", note])


def _baseline(key: str) -> str:
    """Say how often the package's trained policy succeeds, "" if there is none."""
    if key not in baselines.baseline_tasks():
        return ""
    run = baselines.load_baseline(key).runs[0]
    result, training = run["evaluation"]["deterministic"], run["training"]
    share = success_text(result, MYOSUITE)
    return (
        f"`--policy baselines/{key}` has more than 5 solved steps in {share} of {result['episodes']} "
        f"episodes (95 % interval; deterministic actions, `parity` physics). It took "
        f"{training['samples'] / 1e6:.2f} million samples of {training['algorithm'].upper()}, seed "
        f"{training['seed']}. [All baselines](../baselines.md)"
    )


def _measured(audit: dict[str, Any]) -> str:
    """Say what the audit found, with a link to its page."""
    rows = ["| policy | success | failed | return | episodes |", "|---|---|---|---|---|"]
    for name, score in audit["scores"].items():
        rows.append(
            f"| {name} | {100.0 * score['success']:.0f} % | {100.0 * score['failed']:.0f} % "
            f"| {score['return_mean']:.4g} ± {score['return_std']:.2g} | {score['episodes']} |"
        )
    findings = [f"- {finding}" for finding in audit["findings"]]
    place = audit["id"].removeprefix("MyoWarp/")
    return "\n".join([*rows, "", *findings, "", f'<a href="../audit.html#{place}">All figures and plots</a>'])


def families() -> dict[str, list[str]]:
    """Return the ids of each family, by body and then by name, so that versions stand together."""
    order = sorted(TASKS, key=lambda key: (TASKS[key].family, TASKS[key].body, key))
    return {family: list(keys) for family, keys in groupby(order, lambda key: TASKS[key].family)}


def rows(keys: list[str]) -> str:
    """Return a table of ids, a row each."""
    lines = (f"| [{key}]({key}.md) | {TASKS[key].summary} |" for key in keys)
    return "\n".join(["| id | what it asks for |", "|---|---|", *lines])


def family_page(family: str, keys: list[str]) -> str:
    """Return the page of a family: a recording to turn where there is one, its ids, commands."""
    parts = [f"# {TASKS[keys[0]].title}", rows(keys)]
    if shown := TASKS[keys[0]].shown:
        commands = f"myowarp view {shown.task} --policy {shown.policy}\nmyowarp describe {shown.task}"
        parts.insert(1, recordings.frame(family, shown, "../"))
        parts.append(f"```sh\n{commands}\n```")
    parts.append("```{toctree}\n:hidden:\n\n" + "\n".join(keys) + "\n```")
    return "\n\n".join(parts) + "\n"


def index() -> str:
    """Return the page that lists all ids by family."""
    parts = [
        "# Tasks",
        "A page for each family, with a recording to turn, and one for each id, with every number of its "
        "observation. `myowarp tasks` prints this list, `myowarp tasks --paper` the paper's grid of 204 ids.",
    ]
    for family, keys in families().items():
        parts.append(f"## {TASKS[keys[0]].title}\n\n[Recording and commands]({family}.md)\n\n{rows(keys)}")
    parts.append("```{toctree}\n:hidden:\n\n" + "\n".join(families()) + "\n```")
    return "\n\n".join(parts) + "\n"


def write(app: Sphinx) -> None:
    """Write all pages whose text changed."""
    PAGES.mkdir(exist_ok=True)
    audits = {entry["task"]: entry for entry in json.loads((DOCS / "audit/audit.json").read_text())["audits"]}
    texts = {"index": index()} | {family: family_page(family, keys) for family, keys in families().items()}
    for key in status_iterator(TASKS, "describing tasks... ", "brown", len(TASKS), app.verbosity):
        texts[key] = page(key, audits.get(key))
    for stale in set(PAGES.glob("*.md")) - {PAGES / f"{name}.md" for name in texts}:
        stale.unlink()
    for name, text in texts.items():
        path = PAGES / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
