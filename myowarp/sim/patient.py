"""The patient at one's fingertips: parameters of conditions, changed while the worlds are stepped.

    sim = Simulation(spec, 2, conditions=every_condition(spec), adjustable=True)
    patient = Patient(sim)
    knob = patient.knobs["sarcopenia strength"]
    patient.set(knob, 0.3, worlds=[0], muscles=["BIClong"])  # world 1 stays as it was

What a condition declares as a `Parameter` is a knob; nothing is named here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from myowarp.definitions.body import BODIES
from myowarp.definitions.condition import CONDITIONS, Condition, attributes_of, resolve
from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.parameter import Parameter
from myowarp.definitions.task import TaskSpec
from myowarp.sim.simulation import Simulation

STEPS = 200  # of a slider
ROUND = (1.0, 2.0, 5.0, 10.0)  # first figures of a slider's end


def every_condition(spec: TaskSpec, given: Sequence[str | Condition] = ()) -> tuple[Condition, ...]:
    """Return the given conditions, and every other that a body can have beside them, neutral.

    Raises:
        ValueError: A given condition does not suit.
    """
    found = resolve(given, spec)
    for name in CONDITIONS:
        if name in {condition.name for condition in found}:
            continue
        try:
            found = resolve((*found, *CONDITIONS[name].neutrals(spec)), spec)
        except ValueError:  # not in this body, or not beside the others
            continue
    return found


@dataclass(frozen=True, eq=False)
class Knob:
    """A parameter that can be changed.

    Attributes:
        condition: Name of the condition.
        field: Name of the parameter in it.
        parameter: The parameter.
        low: Least value.
        high: Greatest value of a slider; `Patient.set` takes more where the parameter does.
        place: Where it is, as a joint; "" where a body has one alone.
    """

    condition: str
    field: str
    parameter: Parameter
    low: float
    high: float
    place: str = ""

    @property
    def name(self) -> str:
        """Condition, parameter and place."""
        return f"{self.condition} {self.field}" + (f" of {self.place}" if self.place else "")

    @property
    def label(self) -> str:
        """Its common name, with its unit."""
        label = CONDITIONS[self.condition].LABELS.get(self.field, self.field.replace("_", " "))
        return label + (f" [{self.unit}]" if self.unit else "")

    @property
    def doc(self) -> str:
        """Return its meaning from the condition's docstring; "" if there is none."""
        return attributes_of(CONDITIONS[self.condition]).get(self.field, "")

    @property
    def unit(self) -> str:
        """Its unit, which `doc` has in brackets; "" where it has none."""
        found = re.search(r"\[([^\]]+)\]", self.doc)
        return "" if found is None or found[1] == "1" else found[1]

    @property
    def step(self) -> float:
        """Step of a slider."""
        return (self.high - self.low) / STEPS


class Patient:
    """The knobs of a simulation.

    Attributes:
        knobs: Knobs by name, in the order in which conditions act.
        groups: Names of muscles by what they are chosen with: "all", a group, or a muscle's own name.
    """

    def __init__(self, sim: Simulation) -> None:
        """Find the knobs.

        Args:
            sim: A simulation made with `adjustable`, of one shard.
        """
        (self._shard,) = sim.shards
        self._changed: dict[tuple[str, int], np.ndarray] = {}
        found = (_knob(parameter, sim.conditions) for parameter in self._shard.scene.parameters)
        self.knobs = {knob.name: knob for knob in found if knob is not None}
        names = sim.scene.muscles.names
        self.groups: dict[str, tuple[str, ...]] = {"all muscles": tuple(names)}
        for name in names:
            if group := BODIES[sim.scene.spec.body].group_of(name):
                self.groups[group] = (*self.groups.get(group, ()), name)
        self.groups |= {name: (name,) for name in names}
        self._at_first = {knob: knob.parameter.curve.start.numpy().copy() for knob in self.knobs.values()}

    def value(self, knob: Knob, world: int, muscles: Sequence[str] = ()) -> float:
        """Return what a world has, the mean of some muscles."""
        values = knob.parameter.values(world)
        columns = _columns(knob, muscles)
        return float(values[columns].mean() if len(values) > 1 else values[0])

    def idle(self, knob: Knob, world: int, muscles: Sequence[str] = ()) -> str:
        """Return why turning a knob has no effect on some muscles now, a sentence; "" where it has one."""
        kind = CONDITIONS[knob.condition]
        needed = self.knobs.get(f"{knob.condition} {kind.NEEDS}")
        if needed is not None and needed is not knob:
            neutral = kind.NEUTRAL[kind.NEEDS]
            if self.value(needed, world, muscles) == neutral:
                return f"No effect while {needed.label!r} is {neutral:g}."
        if knob.field in kind.AT_START:
            return "Acts from the next episode on: press Reset."
        return ""

    def undo(self, worlds: Sequence[int]) -> None:
        """Give worlds what they had when the patient was made."""
        for knob, values in self._at_first.items():
            for world in worlds:
                own = values[world % len(values)]
                knob.parameter.set(own, [world % len(values)], range(len(own)))
        self._changed.clear()

    def set(
        self, knob: Knob, value: npt.ArrayLike, worlds: Sequence[int], muscles: Sequence[str] = ()
    ) -> None:
        """Change a parameter in some worlds, of some muscles, () for all: one value, or one for each muscle.

        Raises:
            ValueError: The value is out of its range, or the conditions cannot act together; nothing changed.
        """
        before = {world: knob.parameter.values(world).copy() for world in worlds}
        knob.parameter.set(value, worlds, _columns(knob, muscles))
        try:
            for effect in self._shard.effects:
                effect.check_beside(self._shard.effects)
        except ValueError:
            for world, values in before.items():
                knob.parameter.set(values, [world], range(len(values)))
            raise
        for world in worlds:
            self._changed[knob.name, world] = knob.parameter.values(world).copy()

    def renew(self) -> None:
        """Set what was changed once more, after a reset has drawn parameters anew."""
        for (name, world), values in self._changed.items():
            parameter = self.knobs[name].parameter
            if parameter.draws:
                parameter.set(values, [world], range(len(values)))


def _columns(knob: Knob, muscles: Sequence[str]) -> list[int]:
    """Return the columns of a parameter that stand for muscles; those that it is not about are left out."""
    names = knob.parameter.names
    if not names:
        return [0]
    return [muscle_index(muscle, names) for muscle in muscles if muscle in names] or list(range(len(names)))


def _knob(parameter: Parameter, conditions: Sequence[Condition]) -> Knob | None:
    """Return the knob of a parameter of a condition; None where no end of its slider is known.

    A ramp, which changes by itself, has none either.
    """
    what, _, place = parameter.name.partition(" of ")
    name, _, field = what.partition(" ")
    kind = next((condition for condition in conditions if condition.name == name), None)
    if kind is None or parameter.curve.start.ptr != parameter.curve.end.ptr:
        return None
    default = getattr(type(kind), field, None)
    low, high = parameter.bounds
    known = [abs(float(n)) for n in (default, parameter.neutral) if isinstance(n, (int, float))]
    now = float(parameter.curve.start.numpy().max(initial=0.0))
    top = max(now, parameter.usual or (high if high <= 1.0 else 2.0 * max(*known, now)))
    if top > 0.0 and top != high:
        power = 10.0 ** np.floor(np.log10(top))
        top = min(high, power * next(figure for figure in ROUND if figure >= 0.999 * top / power))
    bottom = low if np.isfinite(low) else -top
    return Knob(name, field, parameter, bottom, float(f"{top:.3g}"), place) if top > bottom else None
