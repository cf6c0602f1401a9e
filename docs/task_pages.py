"""One page for each task id, written before the site is built: `myowarp describe`, audit and baseline.

A Sphinx extension; the pages go to docs/tasks/, which git ignores.
"""

import json
from itertools import groupby
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.display import status_iterator

from myowarp.apps.policies import baselines
from myowarp.apps.reports.describe import describe
from myowarp.apps.reports.describe_text import sections
from myowarp.definitions.task import TASKS

DOCS = Path(__file__).parent
PAGES = DOCS / "tasks"
WIDTH = 92  # characters that a page shows without scrolling at 1280 px


def page(key: str, audit: dict[str, Any] | None) -> str:
    """Return the page of a task id as Markdown."""
    spec = TASKS[key]
    facts = sections(describe(spec), WIDTH)
    about = facts.pop(spec.env_id)
    commands = (
        f"myowarp rollout {key} --num-worlds 64 --video task.mp4\nmyowarp train {key} --output runs/task"
    )
    picture = f"![{spec.family}, {spec.body}](../pictures/{spec.family}_{spec.body}.png)"
    parts = [f"# {key}", " ".join(about.split()), picture, f"```sh\n{commands}\n```"]
    if baseline := _baseline(key):
        parts.append(f"## Trained policy\n\n{baseline}")
    if audit:
        parts.append(f"## Measured\n\n{_measured(audit)}")
    parts += [f"## {title}\n\n```text\n{text}\n```" for title, text in facts.items()]
    return "\n\n".join(parts) + "\n"


def _baseline(key: str) -> str:
    """Say how often the package's trained policy succeeds, "" if there is none."""
    if key not in baselines.baseline_tasks():
        return ""
    run = baselines.load_baseline(key).runs[0]
    result, training = run["evaluation"]["deterministic"], run["training"]
    low, high = (100.0 * bound for bound in result["intervals"]["success"])
    return (
        f"`--policy baselines/{key}` succeeds in {100.0 * result['success']:.1f} % of {result['episodes']} "
        f"episodes (95 % interval {low:.1f} to {high:.1f}; deterministic actions, `parity` physics). It took "
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


def index() -> str:
    """Return the page that lists all ids by family, with the newest version of each task first."""
    parts = [
        "# Tasks",
        "`myowarp tasks` prints this list, and `myowarp tasks --paper` the paper's grid of 204 ids.",
    ]
    by_family = sorted(TASKS, key=lambda key: TASKS[key].family)
    for family, keys in groupby(by_family, lambda key: TASKS[key].family):
        rows = "\n".join(f"| [{key}]({key}.md) | {TASKS[key].summary} |" for key in keys)
        parts.append(f"## {family}\n\n| id | what it asks for |\n|---|---|\n{rows}")
    parts.append("```{toctree}\n:hidden:\n:glob:\n\n*\n```")
    return "\n\n".join(parts) + "\n"


def write(app: Sphinx) -> None:
    """Write all pages whose text changed."""
    PAGES.mkdir(exist_ok=True)
    audits = {entry["task"]: entry for entry in json.loads((DOCS / "audit/audit.json").read_text())["audits"]}
    texts = {"index": index()}
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
