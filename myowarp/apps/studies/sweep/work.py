"""One run of a study, on any node: train, evaluate, and write its result in one move."""

from __future__ import annotations

import json
import shutil
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from myowarp.apps.studies.parts import check_settings
from myowarp.apps.studies.sweep.study import POLICY, Run, evaluation, experiment, training
from myowarp.definitions.setup import Setup
from myowarp.disk import in_place, locked, make_folder, plain

RESULT, LOCK = "result.json", ".lock"


def finished(run: Run, output: Path) -> dict[str, Any] | None:
    """Return the result of a run that was done before; None if it was not.

    Raises:
        ValueError: It was done with other settings, or its result is damaged.
    """
    path = output / run.name / RESULT
    try:
        found = json.loads(path.read_text())
        recorded = found["run"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"result {str(path)!r} is damaged ({error}); delete it") from error
    wanted = run.as_dict()
    here, there = ({**of["options"], "episodes": of["episodes"]} for of in (wanted, recorded))
    check_settings(f"result {str(path)!r} was made with", there, here)
    return dict(found)


def do(run: Run, output: Path) -> dict[str, Any]:
    """Do a run, or what is left of it, and return its result; one that is done is not done again.

    Raises:
        ValueError: It cannot be done.
        OSError: It cannot be written.
        RuntimeError: It diverged, or was stopped.
    """
    folder = output / run.name
    make_folder(folder)
    with locked(folder / LOCK, wait=True):  # a process that was given up may still be at it
        if (found := finished(run, output)) is not None:
            return found
        begin = time.monotonic()
        figures = DO[run.kind](run, folder)
        result = {"run": run.as_dict(), "seconds": time.monotonic() - begin, "node": socket.gethostname()}
        with in_place(folder / RESULT) as scratch:
            scratch.write_text(json.dumps(plain(result | {"figures": figures}), indent=1) + "\n")
    return {**result, "figures": figures}


def _train(run: Run, folder: Path) -> dict[str, Any]:
    """Train a policy and evaluate it."""
    from myowarp.apps.policies.checkpoint import last_saved
    from myowarp.apps.reports.evaluation import evaluate_policy, plan_evaluation
    from myowarp.apps.train.run import train

    home = folder / POLICY
    if last_saved(home) is None:
        shutil.rmtree(home, ignore_errors=True)
    report = train(training(run, folder))
    if report["ended"].startswith("stopped"):
        raise RuntimeError(f"run {run.name!r} was {report['ended']}; the same command goes on")
    where = Setup(device=run.options.get("device"))
    job = plan_evaluation(home, where, episodes=run.episodes)
    _, figures = evaluate_policy(job)
    return {"training": report, **figures}


def _eval(run: Run, folder: Path) -> dict[str, Any]:
    """Evaluate a policy."""
    from myowarp.apps.reports.evaluation import evaluate_policy

    return evaluate_policy(evaluation(run, folder))[1]


def _reproduce(run: Run, folder: Path) -> dict[str, Any]:
    """Run an experiment of the paper."""
    from myowarp.apps.studies.reproduce.run import reproduce

    job = experiment(run, folder)
    reproduce(job)
    return {"merits": json.loads((job.folder / "result.json").read_text())["merits"]}


DO: dict[str, Callable[[Run, Path], dict[str, Any]]] = {
    "train": _train,
    "eval": _eval,
    "reproduce": _reproduce,
}
