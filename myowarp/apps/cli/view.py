"""The command `myowarp view`: a policy moves a body in the browser, and the patient can be changed."""

from __future__ import annotations

import contextlib
import dataclasses
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from rich.console import Console

from myowarp.apps.cli.options import Environment, OwnPolicy, Recording, Said, Trial, optional
from myowarp.definitions.registry import check_least

if TYPE_CHECKING:
    from viser import ViserServer

    from myowarp.definitions.setup import Setup
    from myowarp.definitions.task import TaskSpec
    from myowarp.sim.simulation import Simulation
    from myowarp.view.browser.live import Live
    from myowarp.view.browser.session import Act, Choices, Session
    from myowarp.view.browser.trial_page import TrialPage


PORT = 8080


@dataclass
class View:
    """Show a policy in the browser: muscles in the colour of what they do, readings, traces, and the patient.

    Sliders change strength, tears, fatigue, noise, exoskeleton and load of a muscle, a group or all while the
    policy runs; "beside" shows the same body from the same state without the change. Everything stands still
    while no page is open. Ctrl-C ends it.

    Example: myowarp view myoHandReachFixed-v1 --policy baselines/myoHandReachFixed-v0

    A converted model: myowarp view --model out/arm26/model.xml

    A training that goes on: myowarp view runs/elbow, whose best policy so far acts

    A recorded motion, with muscle forces in colour and ground reaction as arrows:
    myowarp view --model gait.osim --motion out/trial --loads grf.xml
    """

    asked: Environment
    policy: OwnPolicy = ""
    free: bool = False
    """Let a body of --model fall. By default the part that carries all others is held in place, as if in a
    harness, unless a policy of yours acts."""
    worlds: int = 1
    """Worlds to choose from."""
    preset: Annotated[str | None, optional("NAME")] = None
    """Patient to begin with beside the healthy twin, such as "FPL torn" or fatigued; the page lists them."""
    port: int = PORT
    """Port of the page on this machine, 0 for a free one; from another one: ssh -L 8080:localhost:8080."""
    browser: bool = False
    """Open the page in this machine's browser."""
    recording: Recording = dataclasses.field(default_factory=Trial)

    def __call__(self) -> None:
        """Check, build, serve."""
        from myowarp.view.modes import check_viser

        check_viser("myowarp view")
        from myowarp.apps.policies.find import find_policy
        from myowarp.sim.presets import PRESETS
        from myowarp.view.browser.live import Live
        from myowarp.view.browser.server import check_port, close_server, open_server

        check_least(1, worlds=self.worlds)
        if (source := self.recording.source(self.asked)) is not None:
            return self._play(source)
        if (run := self.of_run()) is not None:
            return run()
        find_policy(self.first_policy, self._find(self.title).spec)
        if self.preset is not None:
            PRESETS[self.preset]
        check_port(self.port)
        session, choices = self.open(self.title, self.first_policy), self.choices()
        if self.preset is not None:
            session.become(self.preset)
            session.beside = True
        server = open_server(self.port, self.title)
        try:
            self._serve(server, Live(server, session, choices))
        finally:
            close_server(server)

    def _play(self, source: Path) -> None:
        """Show a recorded motion."""
        from myowarp.view.browser.server import check_port, close_server, open_server
        from myowarp.view.browser.trial_page import TrialPage
        from myowarp.view.drawing.recorded import Recorded

        trial = self.recording
        assert trial.motion is not None
        check_port(self.port)
        recorded = Recorded(source, trial.motion, trial.results, trial.loads)
        title = f"{trial.motion.stem} of {source.stem}"
        server = open_server(self.port, title)
        try:
            self._serve(server, TrialPage(server, recorded))
        finally:
            close_server(server)

    def _serve(self, server: ViserServer, page: Live | TrialPage) -> None:
        """Say where the page is, and run it."""
        from myowarp.view.modes import has_browser

        address = f"http://localhost:{server.get_port()}"
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        console.print(f"Open {address}   (Ctrl-C ends)")
        if self.browser and has_browser():
            webbrowser.open(address)
        with contextlib.suppress(KeyboardInterrupt):
            page.run()

    def of_run(self) -> View | None:
        """Return the command of a run's task and policy, where its folder stands in place of a task."""
        from myowarp.apps.policies.follow import is_run
        from myowarp.apps.reports.evaluation import plan_evaluation

        asked = self.asked.setup
        if not isinstance(asked.task, str) or not is_run(asked.task):
            return None
        setup = plan_evaluation(Path(asked.task), dataclasses.replace(asked, task=None)).setup
        said = Said(dataclasses.replace(setup, task=setup.spec.key))
        return dataclasses.replace(self, asked=said, policy=asked.task)

    @property
    def first_policy(self) -> str:
        """Return the first policy: the user's, else one that suits a model to look at, or a task."""
        return self.policy or ("zero" if isinstance(self.asked.setup.task, Path) else "random")

    @property
    def title(self) -> str:
        """Return the page's name of the command's task."""
        return str(self.asked.setup.task).removeprefix("MyoWarp/")

    def _find(self, title: str) -> Setup:
        """Return the setup of the command, or the same with another task, by its id."""
        from myowarp.tasks.setups import complete

        asked = self.asked.setup
        return complete(asked if title == self.title else dataclasses.replace(asked, task=title))

    def choices(self) -> Choices:
        """Return what can be chosen; the task and the policy of the command come first."""
        from myowarp.definitions.task import TASKS
        from myowarp.view.browser.session import Choices

        return Choices(
            tasks=list(dict.fromkeys((self.title, *TASKS))),
            policies=lambda spec: policies_for(spec, self.first_policy),
            acting=self._acting,
            note=note_on,
            open=self.open,
        )

    def open(self, title: str, policy: str) -> Session:
        """Return the session of a task; a policy that cannot act there gives way to the best that can."""
        from myowarp.apps.policies.baselines import OWN, PREFIX
        from myowarp.apps.policies.find import BUILT_IN
        from myowarp.view.browser.held import held, root_of
        from myowarp.view.browser.session import Session

        setup = self._find(title)
        offered = policies_for(setup.spec, self.first_policy)
        if policy.startswith(PREFIX) and (title, policy) != (self.title, self.first_policy):
            policy = OWN  # the baseline of this task, whichever it was before
        best = next(name for name in offered if not name.startswith(PREFIX))
        acts, root = policy if policy in offered else best, ""
        file = self.asked.setup.task if title == self.title else None
        if not isinstance(file, Path):
            return Session(title, setup, self.worlds, acts, self._acting)
        if not self.free and self.first_policy in BUILT_IN and (root := root_of(setup.spec)):
            setup = dataclasses.replace(setup, task=held(setup.spec, root))
        return Session(title, setup, self.worlds, acts, self._acting, file, root)

    def _acting(self, name: str, sim: Simulation) -> Act:
        """Return what acts, with the errors of a user's policy as one sentence."""
        from myowarp.apps.policies.find import PolicyError, acting, find_policy
        from myowarp.apps.policies.follow import Following, is_run

        policy = find_policy(name, sim.scene.spec)
        act = Following(Path(name), sim) if is_run(name) else acting(policy, sim)

        def guarded(obs: np.ndarray) -> np.ndarray:
            try:
                return act(obs)
            except PolicyError as error:
                raise RuntimeError(f"{error} ({error.__cause__})") from error

        return guarded


def policies_for(spec: TaskSpec, own: str) -> list[str]:
    """Return the names of the policies that can act in a task: the user's own, then those of the package."""
    from myowarp.apps.policies.baselines import OWN
    from myowarp.apps.policies.find import BUILT_IN, find_policy

    found = []
    for name in dict.fromkeys((own, OWN, *BUILT_IN)):
        with contextlib.suppress(ValueError):
            find_policy(name, spec)
            found.append(name)
    return found


def note_on(policy: str, spec: TaskSpec) -> str:
    """Return what is to be said of a policy in a task, Markdown: which version it was trained for."""
    from myowarp.apps.policies.baselines import policy_folder
    from myowarp.apps.policies.checkpoint import find_folder
    from myowarp.apps.policies.follow import is_run

    if policy.rpartition(":")[1] or (folder := policy_folder(policy, spec.key)) is None:
        return ""
    if is_run(policy):
        return f"Follows {policy}; its policy of {int(find_folder(folder).name)} samples acts."
    trained = folder.name
    if trained == spec.key:
        return f"Trained for {trained}."
    return (
        f"Trained for **{trained}**, another version of this task."
        if trained.rpartition("-")[0] == spec.name
        else (f"Trained for **{trained}**.")
    )
