"""The session of a page: a running task, its policy, its patient, and the same patient without the change.

The last world is the twin: it has the conditions that the session began with, and starts from the state that
the shown world is in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TaskSpec
from myowarp.osim.bundle.couplings import follow
from myowarp.sim.build import full_spec
from myowarp.sim.economy import Economy
from myowarp.sim.interop import ActionInput
from myowarp.sim.patient import Knob, Patient, every_condition
from myowarp.sim.presets import PRESETS
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state, place, set_state
from myowarp.view.drawing.snapshot import Snapshot, snapshot

Act = Callable[[np.ndarray], np.ndarray]
"""Observations (num_worlds, obs_size) to actions (num_worlds, num_actions) in [-1, 1].

One that remembers has `copy(source, target)`, too: a world remembers what another one does.
"""

HEALTHY = "as it began"
"""The patient without a preset: what the command's conditions say."""
OPEN_LOOP = "random"
"""Policy that does not look at observations: the twin does what the shown world does."""
AT_REST = "zero"
"""Policy that commands nothing."""


@dataclass(frozen=True)
class Choices:
    """Choices of a page.

    Attributes:
        tasks: Ids of tasks.
        policies: Function from a task to the names of policies that may act in it.
        acting: Function from the name of a policy and a simulation to what acts.
        note: Function from the name of a policy and a task to what is said of it, Markdown; "" for nothing.
        open: Function from the id of a task and the name of a policy to a session.
    """

    tasks: Sequence[str]
    policies: Callable[[TaskSpec], Sequence[str]]
    acting: Callable[[str, Simulation], Act]
    note: Callable[[str, TaskSpec], str]
    open: Callable[[str, str], Session]


class Session:
    """A task that runs.

    Attributes:
        title: What it is called.
        sim: Its worlds, the twin last.
        patient: What can be changed in them.
        policy: Name of what acts.
        world: The shown world.
        twin: Number of the twin.
        beside: Whether the twin is shown; only then does its end end the episode.
        returns: Sum of rewards in the present episode, shape (num_worlds,).
        steps: Control steps since the session was opened.
        episode: Number of the shown world's episode, from 1 on.
        succeeded: How many of its episodes before ended as a success.
        preset: Name of the patient that was chosen last.
        file: The file that its model is from; None: a task has its model.
        held: Name of the body of that model that is held in place; "" for none.
    """

    def __init__(
        self,
        title: str,
        setup: Setup,
        worlds: int,
        policy: str,
        acting: Callable[[str, Simulation], Act],
        file: Path | None = None,
        held: str = "",
    ) -> None:
        """Build the simulation, and reset it.

        Args:
            title: What it is called.
            setup: What runs; the patient has its conditions from the beginning.
            worlds: Worlds to choose from.
            policy: Name of what acts.
            acting: As in `Choices`.
            file: The file that the model is from; None: the task has one.
            held: Name of the body that is held in place; "" for none.

        Raises:
            ValueError: An argument is wrong.
        """
        spec, conditions = setup.spec, setup.conditions or ()
        plain = full_spec(spec)
        muscles = any(actuator.dyntype == mujoco.mjtDyn.mjDYN_MUSCLE for actuator in plain.actuators)
        self.sim = Simulation(
            setup,
            worlds + 1,
            conditions=every_condition(spec, conditions) if muscles or conditions else (),
            shards=1,
            autoreset="disabled",
            adjustable=True,
        )
        self.title, self.world, self.twin, self.beside = title, 0, worlds, False
        self.file, self.held = file, held
        self.signals = Signals(self.sim) if muscles else None
        self.economy = Economy(self.sim, self.signals) if self.signals is not None else None
        self.patient = Patient(self.sim)
        self._acting, self._take = acting, ActionInput(self.sim.action)
        self._own = {body.name for body in plain.bodies}
        self.returns, self.steps = np.zeros(worlds + 1), 0
        self.episode, self.succeeded, self.preset = 0, 0, HEALTHY
        self.act(policy)
        self._seeds: np.ndarray | None = (setup.seed or 0) + np.arange(worlds + 1)
        self.restart()

    @property
    def time(self) -> float:
        """Time of the shown world's episode [s]."""
        return int(self.sim.episode.step_count.numpy()[self.world]) * self.sim.scene.control_dt

    @property
    def elapsed(self) -> float:
        """Time since the session was opened [s]."""
        return self.steps * self.sim.scene.control_dt

    @property
    def success(self) -> bool:
        """Whether the shown world's episode counts as a success so far; it may yet fail."""
        return self.time > 0.0 and bool(self.sim.transition.success.numpy()[self.world])

    @property
    def failed(self) -> bool:
        """Whether failure or a fault has ended the shown world's episode."""
        return self.time > 0.0 and bool(self.sim.transition.terminated.numpy()[self.world])

    def walk(self, world: int) -> dict[str, float]:
        """Return rate, speed and cost of transport of a world's episode so far; {} of what fell or hangs."""
        if self.economy is None or self.held or self.sim.transition.terminated.numpy()[world]:
            return {}
        return {name: float(values[world]) for name, values in self.economy.means().items()}

    @property
    def scored(self) -> bool:
        """Whether return and reward say something: nobody has asked for the task that is made of a file."""
        return self.file is None or self.policy not in (OPEN_LOOP, AT_REST)

    @property
    def terms(self) -> dict[str, float]:
        """Weighted reward terms of the last step in the shown world."""
        return self.terms_of(self.world)

    def terms_of(self, world: int) -> dict[str, float]:
        """Return the weighted reward terms of the last step in a world."""
        values = self.sim.transition.terms.numpy()[world]
        pairs = zip(self.sim.terms, values, strict=True)
        return {term.name: term.weight * float(value) for term, value in pairs if term.weight}

    def act(self, policy: str) -> None:
        """Let another policy act.

        Raises:
            ValueError: It cannot act here; the one before goes on.
        """
        self._act = self._acting(policy, self.sim)
        self.policy = policy

    def show(self, world: int) -> None:
        """Choose the shown world; the twin becomes like it.

        Raises:
            ValueError: There is no such world.
        """
        if not 0 <= world < self.twin:
            raise ValueError(f"world must be from 0 to {self.twin - 1}, got {world}")
        self.world = world
        self.match()

    def match(self) -> None:
        """Put the twin into the state of the shown world, as its policy remembers it; its conditions stay."""
        set_state(self.sim, get_state(self.sim, self.world), self.twin, conditions=False)
        self.returns[self.twin] = self.returns[self.world]
        for remembering in (self.economy, self._act):
            if (copy := getattr(remembering, "copy", None)) is not None:
                copy(self.world, self.twin)

    def turn(self, knob: Knob, value: float, muscles: Sequence[str]) -> None:
        """Change the patient in all worlds but the twin.

        Raises:
            ValueError: The value is out of its range, or conditions cannot act together.
        """
        self.patient.set(knob, value, range(self.twin), muscles)

    def become(self, preset: str) -> None:
        """Make all worlds but the twin a patient of `PRESETS`, or what they began as; episodes begin anew.

        Raises:
            ValueError: There is no such preset, or this body cannot have it.
        """
        if preset == HEALTHY:
            self.patient.undo(range(self.twin))
        else:
            PRESETS[preset].put_into(self.patient, range(self.twin))
        self.preset = preset
        self.restart()

    def pose(self, qpos: np.ndarray) -> None:
        """Put shown world and twin into a configuration, at rest; joints that follow others follow.

        Raises:
            ValueError: It is not finite.
        """
        follow(self.sim.full_model, qpos)
        pair = np.array([self.world, self.twin])
        place(
            self.sim,
            {"data.qpos": np.tile(qpos, (2, 1)), "data.qvel": np.zeros((2, self.sim.scene.oracle.nv))},
            pair,
        )
        if self.economy is not None:
            self.economy.start(np.isin(np.arange(self.twin + 1), pair))

    def restart(self, mask: np.ndarray | None = None) -> None:
        """Begin new episodes, in all worlds or a mask; the twin's begins like that of the shown world."""
        mask = np.ones(self.twin + 1, dtype=bool) if mask is None else mask
        mask[self.twin] = mask[self.world]
        self.sim.reset(mask, self._seeds)
        self._seeds = None
        self.returns[mask] = 0.0
        if self.economy is not None:
            self.economy.start(mask)
        self.patient.renew()
        if mask[self.world]:
            self.episode += 1
            self.match()

    def step(self) -> None:
        """Let the policy act once; episodes that ended begin anew, those of shown world and twin together.

        Raises:
            ValueError: The policy's actions do not fit.
        """
        sim = self.sim
        if (ended := self._ended()).any():
            self.succeeded += bool(ended[self.world] and self.success)
            self.restart(ended)
        actions = self._act(sim.transition.obs.numpy())
        if self.policy == OPEN_LOOP:
            actions[self.twin] = actions[self.world]
        self._take(actions)
        sim.step()
        self.steps += 1
        self.returns += sim.transition.reward.numpy()
        if self.economy is not None:
            self.economy.see(sim.transition.fault.numpy() == 0)

    def _ended(self) -> np.ndarray:
        """Return whose episode has ended, shape (num_worlds,)."""
        transition = self.sim.transition
        ended = transition.terminated.numpy() | transition.truncated.numpy()
        if self.beside:
            ended[self.world] |= ended[self.twin]
        return ended

    def seen(self, world: int) -> Snapshot:
        """Return what a world looks like."""
        return snapshot(self.sim, world, self.signals)

    def hidden(self, world: int) -> frozenset[str]:
        """Return names of bodies that conditions have added and that weigh nothing now: they are not worn."""
        oracle, mass = self.sim.scene.oracle, self.sim.scene.model.body_mass.numpy()
        own = mass[world % len(mass)]
        names = {oracle.body(body).name for body in np.flatnonzero(own == 0.0)}
        return frozenset(names - self._own)
