"""The command `myowarp view`: a policy moves a body in the browser, and the patient can be changed."""

from __future__ import annotations

import contextlib
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.console import Console

from myowarp.apps.cli.options import Conditions, Device, Model, OptionalTask, Physics, Policy, Reset
from myowarp.definitions.registry import check_least

if TYPE_CHECKING:
    from myowarp.definitions.task import TaskSpec
    from myowarp.sim.simulation import Simulation
    from myowarp.tasks.variants import Variant
    from myowarp.view.browser.session import Act, Choices, Session

TOKEN_BYTES = 16


@dataclass
class View:
    """Show a policy in the browser: muscles in the colour of what they do, readings, traces, and the patient.

    Sliders change strength, tears, fatigue, noise, exoskeleton and load of a muscle, a group or all while the
    policy runs; "beside" shows the same body from the same state without the change. Everything stands still
    while no page is open. Ctrl-C ends it.

    Example: myowarp view myoHandReachFixed-v1 --policy baselines/myoHandReachFixed-v0

    A converted model: myowarp view --model out/arm26/model.xml
    """

    task: OptionalTask = None
    model: Model = None
    policy: Policy = "random"
    worlds: int = 1
    """Worlds to choose from."""
    conditions: Conditions = ()
    reset: Reset = None
    physics: Physics = "parity"
    device: Device = None
    seed: int = 0
    """Seed of the first reset and of the random policy."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen at. Elsewhere than on this machine, the printed address holds a token."""
    port: int = 8080
    """Port of the page; 0 for any that is free."""

    def __call__(self) -> None:
        """Check, build, serve."""
        from myowarp.view.modes import check_viser

        check_viser("myowarp view")
        from myowarp.apps.rollouts.rollout import find_policy
        from myowarp.definitions.task import TASKS
        from myowarp.view.browser.live import Live
        from myowarp.view.browser.server import (
            LOCAL,
            LOCAL_NAMES,
            Gate,
            address_of,
            check_port,
            close_server,
            open_server,
        )

        check_least(1, worlds=self.worlds)
        check_least(0, seed=self.seed)
        find_policy(self.policy, TASKS[self._find(self._title).task])
        local = self.host in LOCAL_NAMES
        check_port(LOCAL if local else self.host, self.port)
        session, choices = self._open(self._title, self.policy), self._choices()
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        server = open_server(self.port if local else 0, "MyoWarp")
        with contextlib.ExitStack() as stack:
            stack.callback(close_server, server)
            address = address_of("localhost", server.get_port())
            if not local:
                token = secrets.token_urlsafe(TOKEN_BYTES)
                gate = Gate(self.host, self.port, server.get_port(), token)
                stack.callback(gate.close)
                address = f"{address_of(self.host, gate.port)}/?token={token}"
            live = Live(server, session, choices)
            console.print(f"Open {address}   (Ctrl-C ends)")
            with contextlib.suppress(KeyboardInterrupt):
                live.run()

    @property
    def _title(self) -> str:
        """What the page calls the task of the command."""
        return str(self.task).removeprefix("MyoWarp/") if self.task else str(self.model)

    def _find(self, title: str) -> Variant:
        """Return the task of the command, or another one by its id."""
        from myowarp.tasks.from_file import task_or_model

        own = title == self._title
        return task_or_model(self.task if own else title, self.model if own else None)

    def _choices(self) -> Choices:
        """Return what can be chosen; the task and the policy of the command come first."""
        from myowarp.tasks.variants import variants
        from myowarp.view.browser.session import Choices

        ids = (env_id.removeprefix("MyoWarp/") for env_id in variants())
        return Choices(
            tasks=list(dict.fromkeys((self._title, *ids))),
            policies=lambda spec: policies_for(spec, self.policy),
            acting=self._acting,
            open=self._open,
        )

    def _open(self, title: str, policy: str) -> Session:
        """Return the session of a task; a policy that cannot act there gives way to the best that can."""
        from myowarp.apps.policies.baselines import OWN, PREFIX
        from myowarp.definitions.task import TASKS
        from myowarp.view.browser.session import Session

        variant = self._find(title)
        offered = policies_for(TASKS[variant.task], self.policy)
        if policy.startswith(PREFIX) and (title, policy) != (self._title, self.policy):
            policy = OWN  # the baseline of this task, whichever it was before
        best = next(name for name in offered if not name.startswith(PREFIX))
        return Session(
            title,
            TASKS[variant.task],
            self.worlds,
            policy if policy in offered else best,
            self._acting,
            conditions=(*variant.conditions, *self.conditions),
            device=self.device,
            physics=self.physics,
            reset=self.reset or variant.reset,
            seed=self.seed,
        )

    def _acting(self, name: str, sim: Simulation) -> Act:
        """Return what acts, with the errors of a user's policy as one sentence."""
        from myowarp.apps.rollouts.rollout import PolicyError, acting, find_policy

        act = acting(find_policy(name, sim.scene.spec), sim, self.seed)

        def guarded(obs: np.ndarray) -> np.ndarray:
            try:
                return act(obs)
            except PolicyError as error:
                raise RuntimeError(f"{error} ({error.__cause__})") from error

        return guarded


def policies_for(spec: TaskSpec, own: str) -> list[str]:
    """Return the names of the policies that can act in a task: the user's own, then those of the package."""
    from myowarp.apps.policies.baselines import OWN, PREFIX, baseline_tasks
    from myowarp.apps.rollouts.rollout import BUILT_IN, find_policy

    found = []
    for name in dict.fromkeys((own, OWN, *(f"{PREFIX}{task}" for task in baseline_tasks()), *BUILT_IN)):
        with contextlib.suppress(ValueError):
            find_policy(name, spec)
            found.append(name)
    return found
