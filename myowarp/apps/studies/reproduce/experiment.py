"""An experiment, its findings, and the lab in which it runs: seeds, worlds, policies, finished runs."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from myowarp.apps.policies.checkpoint import POLICY, Checkpoint
from myowarp.apps.reports.essay import sections
from myowarp.apps.reports.result import Merit
from myowarp.apps.studies.parts import check_settings
from myowarp.apps.studies.reproduce.policies import Training, committed, retrained
from myowarp.definitions.setup import Setup
from myowarp.disk import in_place, plain, version
from myowarp.progress import progress_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RUNS, POLICIES = "runs", "policies"
"""Folders within the output: finished runs, and policies that were trained again."""

SETTINGS = "settings"  # entry of a run's file

Tick = Callable[[float], None]
"""Takes the share of a run that is done, 0..1."""


@dataclass(frozen=True)
class Findings:
    """Findings of an experiment.

    Attributes:
        merits: Rows of the table.
        holds: Whether ours bear out each conclusion and hypothesis of the essay, by its key; None: open.
        draw: Draws into an empty matplotlib figure 8 inches wide; the height may be set.
        measured: Values for the fields of the essay.
        over: What the values of the figures of merit are over, and the intervals with them; a sentence if
            there are none.
    """

    merits: Sequence[Merit]
    holds: Mapping[str, bool | np.bool_ | None]
    draw: Callable[[Figure], None]
    measured: Mapping[str, Any] = field(default_factory=dict)
    over: str = "seeds"


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper, or one beyond it; its essay is the Markdown file of its name.

    Attributes:
        name: What `myowarp reproduce` calls it.
        run: Runs the protocol.
        ignores: Options of `myowarp reproduce` that the protocol does not read.
    """

    name: str
    run: Callable[[Lab], Findings]
    ignores: tuple[str, ...] = ("models",)

    @property
    def essay(self) -> dict[str, str]:
        """Title, "The paper", "Conclusions", "Where we differ, and why" and "Protocol"; texts by heading."""
        return sections(Path(__file__).with_name(f"{self.name.replace('-', '_')}.md"))

    @property
    def title(self) -> str:
        """One line."""
        return next(iter(self.essay))

    @property
    def paper(self) -> str:
        """Return the place and content of the paper's claim, or that it goes beyond the paper."""
        return " ".join(self.essay["The paper"].split())


@dataclass
class Lab:
    """The user's options, and the runs that are finished.

    Attributes:
        folder: Output folder; it exists.
        seeds: Seeds; each has a policy of its own, trained with that seed.
        num_worlds: Worlds of each seed and condition.
        quick: Whether a first look is enough: shorter protocols, coarser grids.
        retrain: Whether policies are trained here instead of taken from the package.
        overwrite: Whether runs with other settings are replaced instead of refused.
        setup: What the environments have in common, such as device and muscle model.
        models: OpenSim models that the user has.
        console: Where progress is shown.
    """

    folder: Path
    seeds: tuple[int, ...]
    num_worlds: int
    quick: bool = False
    retrain: bool = False
    overwrite: bool = False
    setup: Setup = Setup()
    models: tuple[Path, ...] = ()
    console: Console = field(default_factory=lambda: Console(stderr=True, highlight=False, soft_wrap=True))

    def __post_init__(self) -> None:
        self._expected = self._done = 0
        self._bar: Progress | None = None

    def policy(self, training: Training, seed: int) -> Checkpoint:
        """Return a trained policy: the package's, or one that is trained here, which goes on if broken off.

        Raises:
            ValueError: The package has none of this name and seed, or it is damaged.
            ImportError: It is to be trained, and torch is not installed.
        """
        if not self.retrain:
            return committed(training, seed)
        self.close()  # the training has a bar of its own
        folder = self.folder / POLICIES / training.name / str(seed)
        setup = dataclasses.replace(self.setup, seed=seed)
        return retrained(training, setup, folder, self.console, quick=self.quick)

    def expect(self, runs: int) -> None:
        """Say how many runs there will be, for the progress bar."""
        self._expected += runs

    def kept(
        self,
        name: str,
        settings: Mapping[str, Any],
        measure: Callable[[Tick], dict[str, np.ndarray]],
        *policies: Checkpoint,
    ) -> dict[str, np.ndarray]:
        """Return the arrays of a run: those in the output folder if it was done before, else measured now.

        Args:
            name: Name of the run, unique in the experiment; that of its file.
            settings: All that the result depends on besides the version of the package: seed, worlds,
                conditions, durations; plain values.
            measure: Makes the arrays; it may say how far it is.
            policies: Policies that act; their weights belong to the settings.

        Raises:
            ValueError: The file of this name is damaged, or has other settings and may not be replaced.
            OSError: The file cannot be written.
        """
        digests = [checkpoint.manifest["files"][POLICY]["sha256"][:16] for checkpoint in policies]
        muscle = {k: v for k, v in self.setup.plain().items() if v and k in ("muscle", "muscle_parameters")}
        whole = plain({"myowarp": version("myowarp"), **settings, **muscle, "weights": digests})
        key = json.dumps(whole, sort_keys=True)
        path = self.folder / RUNS / f"{name}.npz"
        try:
            found = _read(path, key)
        except ValueError:
            if not self.overwrite:
                raise
            found = None
        if found is None:
            self._show(name, 0.0)
            found = measure(lambda share: self._show(name, share))
            path.parent.mkdir(exist_ok=True)
            with in_place(path) as scratch, scratch.open("wb") as file:
                np.savez_compressed(file, **{SETTINGS: np.array(key)}, **found)  # type: ignore[arg-type]
        self._done += 1
        self._show(name, 0.0)
        return found

    def _show(self, name: str, share: float) -> None:
        """Show the progress: finished runs and the share of the present one."""
        if self._bar is None:
            self._bar = progress_bar("Running", "runs  {task.description}", self.console)
            self._bar.add_task("", total=self._expected)
            self._bar.start()
        total = max(self._expected, self._done)
        self._bar.update(self._bar.task_ids[0], completed=self._done + share, total=total, description=name)

    def close(self) -> None:
        """Take the progress bar away; the next run brings it back."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


def _read(path: Path, key: str) -> dict[str, np.ndarray] | None:
    """Return the arrays of a finished run; None if there is none.

    Raises:
        ValueError: It is damaged, or has other settings.
    """
    if not path.exists():
        return None
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        recorded = json.loads(str(arrays.pop(SETTINGS)[()]))
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"run {str(path)!r} is damaged ({' '.join(str(error).split())}); delete it, or pass --overwrite"
        ) from error
    remedy = "choose another --output, or pass --overwrite"
    check_settings(f"run {str(path)!r} was made with", recorded, json.loads(key), remedy)
    return arrays
