"""Conditions: changes to a body that vary between patients or over time.

A condition is described on the host by a `Condition`, whose parameters may differ between worlds, be drawn
at random and change over time (`Parameter`), and acts on the device as an `Effect`. What acts when follows
from the stages, never from the order in which conditions are named:

    action -> excitation -> [NOISE -> FATIGUE -> ROUTING] -> muscles x [STRENGTH, TRANSMISSION]
    -> [BODY] -> physics
"""

from __future__ import annotations

import abc
import ast
import dataclasses
import enum
import inspect
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from myowarp.definitions.parameter import Clock, Parameter, Ramp, Uniform
from myowarp.definitions.registry import Registry, check_choice, check_flag
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, RewardTerm, TaskSpec

if TYPE_CHECKING:
    import mujoco
    import warp as wp


class Phase(enum.IntEnum):
    """The place of a condition in a control step, in this order.

    The first three change excitations once per control step (`stretch_reflex` in every physics step);
    `STRENGTH` scales the active force of the muscles, `TRANSMISSION` the force that tendons transmit, `BODY`
    changes masses and adds torques to joints.
    """

    NOISE = 0
    FATIGUE = 1
    ROUTING = 2
    STRENGTH = 3
    TRANSMISSION = 4
    BODY = 5


class Condition(abc.ABC):
    """A condition on the host: parameters, checked; subclasses are dataclasses, frozen, compared by identity.

    Attributes:
        PHASE: Where it acts.
        WRITES: Names of the quantities that it sets. No two conditions of an environment may set the same.
            Factors (strength, transmission) are not listed: they compose.
        NEUTRAL: Parameters with which it changes nothing, bit for bit.
        NEEDS: Parameter at whose neutral value all others change nothing; "": there is none.
        AT_START: Parameters that act where an episode begins, and later not at all.
        TITLE: Its common name; "": its name in `CONDITIONS`.
        LABELS: Common names of its parameters, where they have others.
    """

    PHASE: ClassVar[Phase]
    WRITES: ClassVar[tuple[str, ...]] = ()
    NEUTRAL: ClassVar[dict[str, float]]
    NEEDS: ClassVar[str] = ""
    AT_START: ClassVar[tuple[str, ...]] = ()
    TITLE: ClassVar[str] = ""
    LABELS: ClassVar[dict[str, str]] = {}

    @property
    def name(self) -> str:
        """Name in `CONDITIONS`."""
        return next(name for name in CONDITIONS if CONDITIONS[name] is type(self))

    @classmethod
    def neutral(cls, spec: TaskSpec) -> Condition:
        """Return one that changes nothing in the body of a task, until its parameters are set.

        Raises:
            ValueError: The body cannot have it.
        """
        condition = cls(**cls.NEUTRAL)
        condition.check(spec)
        return condition

    @classmethod
    def neutrals(cls, spec: TaskSpec) -> tuple[Condition, ...]:
        """Return those that a body can have at once, each as `neutral`.

        Raises:
            ValueError: The body cannot have it.
        """
        return (cls.neutral(spec),)

    @property
    def scene_key(self) -> tuple[object, ...]:
        """Return a hashable key of `edit`'s changes to a model; empty where it leaves the model alone."""
        return ()

    @property
    def batched(self) -> tuple[str, ...]:
        """Names of the model's fields that it sets per world."""
        return ()

    @property
    def undriven(self) -> tuple[str, ...]:
        """Names of actuators that it adds, at the end, and that the policy does not command."""
        return ()

    def check(self, spec: TaskSpec) -> None:  # noqa: B027 (most conditions suit every body)
        """Raise ValueError, in one sentence, if the body of a task cannot have this condition."""

    def edit(self, spec: mujoco.MjSpec, body: str) -> None:  # noqa: B027 (most leave the model alone)
        """Add what it needs to the task's full `MjSpec`, in place; `body` is the body's name in `BODIES`."""

    def muscle_names(self, scene: Scene) -> tuple[str, ...]:
        """Return the names of the muscles that it acts on.

        Raises:
            ValueError: The body has none.
        """
        if not scene.muscles.names:
            raise ValueError(f"{self.name} is about muscles; the body of task {scene.spec.key!r} has none")
        return scene.muscles.names

    @abc.abstractmethod
    def bind(self, scene: Scene, clock: Clock) -> Effect:
        """Resolve names and allocate its arrays in a compiled scene.

        Raises:
            ValueError: A parameter does not fit the muscles or the number of worlds.
        """


class Effect:
    """A condition bound to the arrays of a scene. Every method only launches kernels; most do nothing.

    Attributes:
        columns: Blocks that it appends to the observation.
        terms: Reward terms that it appends.
        info: Arrays (num_worlds, ...) of the condition's state by name, shown in the environment's `info`.
        info_units: Units of those of them that are no pure numbers.
        scene: Where it acts; with parameters that are drawn it must be set.
        drawn: Parameters of which new values are drawn where episodes open.
    """

    scene: Scene
    drawn: Iterable[Parameter] = ()
    columns: tuple[Column, ...] = ()
    terms: tuple[RewardTerm, ...] = ()
    info: dict[str, wp.array] = {}  # noqa: RUF012 (replaced, never changed)
    info_units: dict[str, str] = {}  # noqa: RUF012 (the same)

    def check_beside(self, effects: Sequence[Effect]) -> None:
        """Raise ValueError, in one sentence, if it cannot act beside the other effects of the scene."""

    def sample(self, renew: wp.array) -> None:
        """Draw parameters in the worlds of `renew` (num_worlds,) bool, which open an episode."""
        for parameter in self.drawn:
            parameter.sample(self.scene.keys, renew)

    def reset(self, mask: wp.array) -> None:
        """Put its state to rest in the worlds of `mask` (num_worlds,) bool, whose states are reset."""

    def act(self) -> None:
        """Act on excitations, strength, transmission or body, once per control step, before physics."""

    def act_in_substep(self) -> None:
        """Act in every physics step, right after the muscles."""

    def observe(self, mask: wp.array, obs: wp.array, column: int) -> None:
        """Write its columns of `obs`, from `column` on, in the worlds of `mask`."""

    def score(self, terms: wp.array, column: int) -> None:
        """Write its reward terms, from `column` on."""


CONDITIONS: Registry[type[Condition]] = Registry("condition")


def attributes_of(kind: type) -> dict[str, str]:
    """Return what a class says of its attributes: the section `Attributes:` of its docstring, by name."""
    _, _, section = (inspect.getdoc(kind) or "").partition("Attributes:\n")
    found: dict[str, str] = {}
    name = ""
    for line in section.split("\n\n")[0].splitlines():
        if line.startswith("        "):
            found[name] += f" {line.strip()}"
        else:
            name, _, text = line.strip().partition(": ")
            found[name] = text
    return found


VALUES: dict[str, type] = {kind.__name__: kind for kind in (Uniform, Ramp)}
"""Values of parameters that are no plain numbers, by the name that a text has for them."""


def condition_from(text: str) -> Condition:
    """Return the condition that a text stands for: `sarcopenia`, or `sarcopenia(strength=0.3)`.

    Values are written as in Python: numbers, texts, True, tuples, and the classes of `VALUES`, such as
    `Uniform(0.2, 1.0)`; no code is run.

    Raises:
        ValueError: It stands for none, or a value is wrong.
    """
    name, bracket, _ = text.partition("(")
    kind = CONDITIONS[name.strip()]
    if not bracket:
        return kind()
    try:
        call = ast.parse(text.strip(), mode="eval").body
        if not isinstance(call, ast.Call) or call.args:
            raise ValueError("it has values without names")
        if not isinstance(call.func, ast.Name):
            raise ValueError("more than one pair of brackets")
        values = {str(keyword.arg): _value(keyword.value) for keyword in call.keywords}
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(
            f"condition {text!r:.80} must be a name, or a name with values such as sarcopenia(strength=0.3), "
            f"got {error}"
        ) from error
    known = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    for parameter in values:
        check_choice(f"{kind.__name__} parameter", parameter, known)
    return kind(**values)


def _value(node: ast.expr) -> Any:
    """Return what an expression without code stands for.

    Raises:
        ValueError: It has code.
    """
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in VALUES:
        named = {str(keyword.arg): _value(keyword.value) for keyword in node.keywords}
        try:
            return VALUES[node.func.id](*map(_value, node.args), **named)
        except TypeError as error:
            raise ValueError(str(error)) from error
    try:
        return ast.literal_eval(node)
    except ValueError:
        parts = list(ast.walk(node))
        bare = [part.id for part in parts if isinstance(part, ast.Name)]
        if bare and not any(isinstance(part, ast.Call) for part in parts):
            raise ValueError(f'{bare[0]}, which is no number; a text has quotes: "{bare[0]}"') from None
        raise ValueError(f"{ast.unparse(node)}, which is code") from None


def resolve(conditions: str | Condition | Iterable[str | Condition], spec: TaskSpec) -> tuple[Condition, ...]:
    """Return conditions, in the order in which they act.

    Args:
        conditions: One or several, each a text as for `condition_from` or a `Condition`.
        spec: The task whose body is to have them.

    Raises:
        ValueError: A name is unknown, the body cannot have a condition, or two set the same quantity.
    """
    if isinstance(conditions, (str, Condition)) or not isinstance(conditions, Iterable):
        conditions = (conditions,)
    found = []
    for entry in conditions:
        if not isinstance(entry, (str, Condition)):
            known = ", ".join(CONDITIONS)
            raise ValueError(
                f"conditions must be names or Condition objects, got {entry!r}; available: {known}"
            )
        found.append(condition_from(entry) if isinstance(entry, str) else entry)
    writer: dict[str, str] = {}
    for condition in found:
        fields: Iterable[Any] = dataclasses.fields(condition) if dataclasses.is_dataclass(condition) else ()
        for field in fields:
            if isinstance(field.default, bool):
                check_flag(f"{condition.name} {field.name}", getattr(condition, field.name))
        condition.check(spec)
        for quantity in condition.WRITES:
            if quantity in writer:
                both = f"{writer[quantity]!r} and {condition.name!r}"
                raise ValueError(f"conditions {both} both set {quantity}; leave one out")
            writer[quantity] = condition.name
    return tuple(sorted(found, key=lambda condition: (condition.PHASE, condition.name)))
