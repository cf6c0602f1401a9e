"""A study: what its YAML file says, as runs that were checked before the first one starts.

    kind: train                     # train, eval or reproduce
    tasks: [myoElbowPose1D6MRandom-v0, myoFingerPoseRandom-v0]
    conditions: [none, sarcopenia, [sarcopenia, fatigue_3ccr]]
    seeds: 3                        # 0, 1, 2; or a list
    episodes: 256                   # of each evaluation
    settings:                       # options of the command; a list is tried one by one
      samples: 300_000
      learning_rate: [1e-4, 3e-4]

Its runs are tasks x conditions x seeds x settings; `reproduce` has experiments as tasks and seeds of its own.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib.util
import itertools
import json
import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from myowarp.definitions.registry import check_choice, check_least
from myowarp.definitions.setup import OPTIONS, Setup
from myowarp.disk import number_in
from myowarp.extras import to_install
from myowarp.sim.build import MOST_WORLDS

if TYPE_CHECKING:
    from myowarp.apps.reports.evaluation import EvaluationJob
    from myowarp.apps.studies.reproduce.run import ExperimentJob
    from myowarp.apps.train.plan import Job

KINDS = ("train", "eval", "reproduce")
KEYS = ("kind", "tasks", "policies", "conditions", "seeds", "episodes", "settings")
OWN = ("task", "conditions", "seed", "rank")  # of a setup, which have keys of their own or none
SETUP = tuple(name for name in OPTIONS if name not in OWN)
EVAL_SETTINGS = ("mode", *SETUP)
REPRODUCE_SETTINGS = ("quick", "seeds", "num_worlds", "retrain", *SETUP)
EPISODES = 256
LONGEST_NAME = 200  # of a folder
LONGEST_TEXT = 200_000  # of a file; seconds to read
DEEPEST = 10  # brackets in brackets
MOST_RUNS = 10_000
POLICY = "policy"  # folder of what a run trains, in its own


@dataclass(frozen=True)
class Run:
    """A run of a study.

    Attributes:
        name: Its folder.
        kind: One of `KINDS`.
        task: Task id, or experiment.
        cell: What it shares with the runs of other seeds, by axis, in words.
        seed: Its seed; None: it has seeds of its own.
        options: Arguments of the command.
        episodes: Episodes of each evaluation.
    """

    name: str
    kind: str
    task: str
    cell: dict[str, str]
    seed: int | None
    options: dict[str, Any]
    episodes: int

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON gives it back."""
        return dict(json.loads(json.dumps(dataclasses.asdict(self), default=str)))


def read_study(path: Path, output: Path) -> list[Run]:
    """Return the runs of a study, each checked.

    Args:
        path: The YAML file.
        output: Folder of the study, in which some may have been done already.

    Raises:
        ValueError: The file is no study, or one of its runs is impossible; nothing was started.
        ImportError: A package is not installed.
    """
    return _runs(_read(path), f"study {str(path)!r}", output)


def _read(path: Path) -> dict[str, Any]:
    """Return what a YAML file holds."""
    if importlib.util.find_spec("yaml") is None:
        raise ImportError(f"a study needs PyYAML, which is not installed; run {to_install('ray')}")
    import yaml

    try:
        text = path.read_text(encoding="utf-8")
        _check_text(text, f"study {str(path)!r}")
        study = yaml.safe_load(text)
    except FileNotFoundError:
        raise ValueError(f"study {str(path)!r} does not exist") from None
    except (UnicodeDecodeError, OSError, yaml.YAMLError) as error:
        raise ValueError(f"study {str(path)!r} is no YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(study, dict):
        raise ValueError(f"study {str(path)!r} must have the keys kind and tasks, got {study!r:.80}")
    return study


def _check_text(text: str, where: str) -> None:
    """Raise ValueError for text that takes long to read or cannot be a study: aliases may be cycles."""
    import yaml

    if len(text) > LONGEST_TEXT:
        raise ValueError(
            f"{where} must have at most {LONGEST_TEXT:,} characters, got {len(text):,}; make several studies"
        )
    depth = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"{where} has an alias, *{event.anchor}; write out what it stands for")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise ValueError(f"{where} must be nested at most {DEEPEST} deep; leave out brackets")


def _runs(study: Mapping[str, Any], where: str, output: Path) -> list[Run]:
    """Return the runs of a study."""
    for key in study:
        check_choice(f"{where}: key", key, KEYS)
    kind = str(study.get("kind"))
    check_choice(f"{where}: kind", kind, KINDS)
    _check_keys(study, kind, where)
    tasks, policies = _axis(study, "tasks", where), _axis(study, "policies", where, ["baseline"])
    conditions = [_conditions(entry, where) for entry in _axis(study, "conditions", where, ["none"])]
    seeds = _seeds(study.get("seeds", 1), where)
    episodes = study.get("episodes", EPISODES)
    axes = _settings(study.get("settings", {}), kind, where)
    number = math.prod(map(len, (tasks, policies, conditions, *axes.values(), seeds)))
    if number > MOST_RUNS:
        raise ValueError(
            f"{where} must have at most {MOST_RUNS:,} runs, got {number:,}; make several studies"
        )
    product = itertools.product(
        tasks, policies if kind == "eval" else [""], conditions, itertools.product(*axes.values()), seeds
    )
    runs = []
    for task, policy, names, values, seed in product:
        settings = dict(zip(axes, values, strict=True))
        cell = {"task": str(task)} | ({"policy": str(policy)} if kind == "eval" else {})
        cell |= {} if kind == "reproduce" else {"conditions": "+".join(names) or "none"}
        cell |= {name: _word(value) for name, value in settings.items()}
        options = settings if kind == "reproduce" else {**settings, "conditions": names, "seed": seed}
        if kind == "eval":
            options |= {"checkpoint": Path(str(policy))}
        own = None if kind == "reproduce" else seed
        words = [f"{k}={v}" if k in axes else v for k, v in cell.items()]
        name = _folder("__".join([*words, *([] if own is None else [f"seed={own}"])]))
        run = Run(name, kind, str(task), cell, own, options, episodes)
        try:
            check_least(1, MOST_WORLDS, episodes=episodes)
            CHECKS[kind](run, output / name)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{where}: run {name!r} is impossible: {error}") from error
        runs.append(run)
    if twice := [name for name, times in Counter(run.name for run in runs).items() if times > 1]:
        raise ValueError(f"{where}: runs of one name, {min(twice)!r}; leave out what is there twice")
    return runs


def _folder(words: str) -> str:
    """Return what a run is called: its words, or, where they are too many, some and a digest."""
    name = re.sub(r"[^\w.=+-]", "_", words)
    digest = hashlib.sha256(words.encode()).hexdigest()[:12]
    return name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}__{digest}"


def _check_keys(study: Mapping[str, Any], kind: str, where: str) -> None:
    """Raise ValueError for keys that a kind of study does not have."""
    foreign = {
        "train": ("policies",),
        "eval": (),
        "reproduce": ("policies", "conditions", "seeds", "episodes"),
    }
    for key in foreign[kind]:
        if key in study:
            raise ValueError(f"{where}: {kind} has no {key}; leave it out")


def _axis(study: Mapping[str, Any], key: str, where: str, otherwise: list[Any] | None = None) -> list[Any]:
    """Return the entries of a list of a study."""
    entries = study.get(key, otherwise)
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{where}: {key} must be a list with at least one entry, got {entries!r}")
    return entries


def _conditions(entry: Any, where: str) -> tuple[str, ...]:
    """Return the conditions of an entry: none, a name or a list of names."""
    names = [] if entry in ("none", None) else entry if isinstance(entry, list) else [entry]
    if not all(isinstance(name, str) for name in names):
        raise ValueError(f"{where}: conditions must be none, a name or a list of names, got {entry!r}")
    return tuple(names)


def _seeds(seeds: Any, where: str) -> Sequence[int]:
    """Return the seeds of a study: so many from 0 on, or those of a list."""
    if type(seeds) is int and seeds > 0:
        return range(min(seeds, sys.maxsize))  # the most that has a length
    if not isinstance(seeds, list) or not seeds or any(type(s) is not int or s < 0 for s in seeds):
        raise ValueError(
            f"{where}: seeds must be a number of seeds or a list of integers >= 0, got {seeds!r}"
        )
    return seeds


def _settings(settings: Any, kind: str, where: str) -> dict[str, list[Any]]:
    """Return the values of each setting; where a setting is itself a list, a list of lists has several."""
    from myowarp.apps.train.settings import all_settings

    if not isinstance(settings, Mapping):
        raise ValueError(f"{where}: settings must have names and values, got {settings!r}")
    fields = all_settings()
    known = ("algorithm", *fields, *SETUP) if kind == "train" else ()
    known = known or (EVAL_SETTINGS if kind == "eval" else REPRODUCE_SETTINGS)
    axes = {}
    for name, value in settings.items():
        check_choice(f"{where}: setting", name, known)
        is_list = kind == "train" and name in fields and type(fields[name].default) is tuple
        several = isinstance(value, list) and (not is_list or (value and isinstance(value[0], list)))
        axes[name] = [_typed(v, fields, name) for v in (value if several else [value])]
        if not axes[name] or None in axes[name]:
            raise ValueError(f"{where}: setting {name!r} must have a value, got {value!r}; or leave it out")
    return axes


def _typed(value: Any, fields: Mapping[str, Any], name: str) -> Any:
    """Return a value in the type of its setting, as far as YAML hides it: 1e-4 is text there."""
    kind = type(fields[name].default) if name in fields else None
    if kind is float and isinstance(value, str):
        with contextlib.suppress(ValueError):
            return number_in(value)
    return tuple(value) if isinstance(value, list) else value


def _word(value: Any) -> str:
    """Return a value as a word."""
    return "x".join(map(str, value)) if isinstance(value, tuple) else str(value)


def training(run: Run, folder: Path) -> Job:
    """Return the training of a run within its folder, checked; one that was broken off goes on."""
    from myowarp.apps.policies.checkpoint import last_saved
    from myowarp.apps.train.plan import plan

    home = folder / POLICY
    begun = last_saved(home) is not None
    setup, options = _divided(run)
    return plan(setup, output=None if begun else home, resume=home if begun else None, **options)


def _divided(run: Run) -> tuple[Setup, dict[str, Any]]:
    """Return what a run says of its environments, and its other options."""
    own = {name: value for name, value in run.options.items() if name in OPTIONS}
    if "muscle_parameters" in own:
        own["muscle_parameters"] = Path(str(own["muscle_parameters"]))
    return Setup(**own, task=None if run.kind == "reproduce" else run.task), {
        name: value for name, value in run.options.items() if name not in own
    }


def _check_training(run: Run, folder: Path) -> None:
    """Raise ValueError if a run cannot be trained."""
    from myowarp.apps.policies.checkpoint import last_saved

    if last_saved(folder / POLICY) is None:
        folder = folder / "new"  # what was killed before its first checkpoint starts again
    training(run, folder)


def evaluation(run: Run, _: Path) -> EvaluationJob:
    """Return the evaluation of a policy, checked."""
    from myowarp.apps.reports.evaluation import plan_evaluation

    setup, options = _divided(run)
    return plan_evaluation(options.pop("checkpoint"), setup, episodes=run.episodes, **options)


def experiment(run: Run, folder: Path) -> ExperimentJob:
    """Return an experiment of the paper, checked."""
    from myowarp.apps.studies.reproduce.run import plan_experiment

    setup, options = _divided(run)
    return plan_experiment(run.task, output=folder / "experiment", setup=setup, **options)


CHECKS: dict[str, Callable[[Run, Path], object]] = {
    "train": _check_training,
    "eval": evaluation,
    "reproduce": experiment,
}
