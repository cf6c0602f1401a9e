"""A task number by number: observation, actions, reward, success, failure, resets, body, conditions.

    describe(TASKS["myoHandPoseRandom-v1"])["observation"]["blocks"]

Everything comes from the task's spec, its compiled model and its conditions: the dictionary is plain (it
becomes JSON), and `describe_text` prints it.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES, POINT_JOINTS, Body
from myowarp.definitions.condition import Condition, Effect, attributes_of, resolve
from myowarp.definitions.entries import entries, of_joints
from myowarp.definitions.muscle import MuscleModel
from myowarp.definitions.scene import Scene
from myowarp.definitions.senses import bind_senses
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import PHYSICS, RESETS, TASKS, Column, Draw, TaskSpec
from myowarp.engine.compile import quiet
from myowarp.kernels.action import EXCITATION, LINEAR_EXCITATION, MUSCLE, excitation
from myowarp.kernels.episode import FAULTS, SUCCESS_RULE
from myowarp.osim.bundle.couplings import couplings
from myowarp.sim.build import actuator_kinds, compile_scene, num_substeps_of, resolve_device
from myowarp.sim.shard import bind_conditions, observed

LIMITS = "actions are clipped to -1..1"
DRAWN_IN = {
    "task": ("posture", "start", "goal"),
    "fixed": ("start", "goal"),
    "random": ("start", "goal"),
    "none": ("goal",),
}
"""Reset: what `Draw.when` it draws."""

MUSCLE_PARAMETERS = {"max_isometric_force": "N", "optimal_fiber_length": "m", "tendon_slack_length": "m"}
"""Parameters that are shown of a muscle, where its model has them, with units."""


SAID = ("name", "weight", "unit", "doc")
"""Fields that are shown of a term of the reward."""


def describe(what: Setup | TaskSpec, env_id: str | None = None, **fields: Any) -> dict[str, Any]:
    """Return all that a user of a task has to know, as plain dictionaries, lists, texts and numbers.

    Args:
        what: A setup that is complete, or a task alone, registered or not.
        env_id: Id to show; None: the task's.
        **fields: Fields of `Setup`, in place of those of `what`.

    Raises:
        ValueError: The task does not fit its body, or a condition does not fit the task.
    """
    setup = Setup.of(what, **fields)
    spec, found = setup.spec, resolve(setup.conditions or (), setup.spec)
    with quiet(), wp.ScopedDevice(resolve_device("cpu")):
        scene = compile_scene(setup, 1, device="cpu", conditions=found)
        spec.program(spec, scene)
        _, clock, effects = bind_conditions(scene, found)
        columns = observed(scene, effects)
        action = wp.zeros((1, scene.num_actions), dtype=float)
        senses = bind_senses(setup.observe or (), scene, clock, action, columns)
    return {
        "id": env_id or spec.env_id,
        "task": spec.env_id,
        "family": spec.family,
        "family_doc": inspect.getdoc(inspect.getmodule(type(spec))) or "",
        "summary": spec.summary,
        "why": spec.why,
        "versions": _versions(spec),
        "episode": _episode(setup),
        "observation": _observation(scene, (*columns, *(sense.column for sense in senses))),
        "action": _action(scene),
        "reward": _reward(spec, effects),
        "success": {"solved": spec.solved_when, "success": SUCCESS_RULE},
        "failure": {"failed": spec.failed_when, "faults": list(FAULTS.values())},
        "resets": _resets(scene),
        "draws": [_draw(draw, scene.oracle) for draw in spec.draws],
        "body": _body(scene),
        "muscles": _muscles(scene.muscles, BODIES[scene.spec.body]),
        "conditions": [_condition(*pair) for pair in zip(found, effects, strict=True)],
    }


def _versions(spec: TaskSpec) -> list[dict[str, str]]:
    """Return the other versions of a task, and what each says of itself."""
    others = [TASKS[key] for key in TASKS if TASKS[key].name == spec.name and key != spec.key]
    return [{"id": other.env_id, "why": other.why} for other in others]


def _episode(setup: Setup) -> dict[str, Any]:
    """Return durations."""
    spec, physics = setup.spec, {}
    for name, preset in PHYSICS.items():
        substeps = num_substeps_of(spec, preset, setup.muscles.model)
        physics[name] = {
            "integrator": preset.integrator or spec.integrator,
            "steps": substeps,
            "dt": spec.control_dt / substeps,
        }
    return {
        "horizon": spec.horizon,
        "control_dt": spec.control_dt,
        "seconds": spec.horizon * spec.control_dt,
        "physics": physics,
    }


def _observation(scene: Scene, columns: Sequence[Column]) -> dict[str, Any]:
    """Return the blocks of the observation, and each number of them."""
    blocks, first = [], 0
    for column in columns:
        if column.size:
            blocks.append(
                {
                    "name": column.name,
                    "first": first,
                    "last": first + column.size - 1,
                    "unit": column.unit,
                    "doc": column.doc,
                    "entries": [entry._asdict() for entry in column.entries(scene.oracle)],
                }
            )
        first += column.size
    return {"size": first, "blocks": blocks}


def _action(scene: Scene) -> dict[str, Any]:
    """Return what each action does."""
    kinds = actuator_kinds(scene.oracle)[: scene.num_actions]
    rows = [
        _of_muscle(scene, i) if kind == int(MUSCLE) else _of_motor(scene.oracle, i)
        for i, kind in enumerate(kinds)
    ]
    maps = {}
    if any(kinds == int(MUSCLE)):
        linear = scene.spec.linear_excitation
        law = LINEAR_EXCITATION if linear else EXCITATION
        maps["muscle"] = {"law": law, "at": {str(a): excitation(a, linear) for a in (-1, 0, 1)}}
    if any(kinds != int(MUSCLE)):
        maps["motor"] = {"law": "linear, from low at action -1 to high at action 1"}
    return {"size": len(rows), "low": -1.0, "high": 1.0, "limits": LIMITS, "maps": maps, "actuators": rows}


def _of_muscle(scene: Scene, actuator: int) -> dict[str, Any]:
    """Return what an action does to a muscle."""
    name, body = scene.oracle.actuator(actuator).name, BODIES[scene.spec.body]
    low, high = (excitation(a, scene.spec.linear_excitation) for a in (-1.0, 1.0))
    kind = {"index": actuator, "name": name, "kind": "muscle", "quantity": "excitation"}
    return kind | {"unit": "1", "low": low, "high": high, "group": body.group_of(name)}


def _of_motor(model: mujoco.MjModel, actuator: int) -> dict[str, Any]:
    """Return what an action does to an actuator without state: a force or torque, if it has no feedback."""
    low, high = model.actuator_ctrlrange[actuator]
    quantity, unit, factor = "control", "1", 1.0
    plain = (
        model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and not model.actuator_biasprm[actuator].any()
    )
    if plain:
        target = mujoco.mjtTrn(model.actuator_trntype[actuator])
        factor = float(model.actuator_gainprm[actuator, 0] * model.actuator_gear[actuator, 0])
        if target == mujoco.mjtTrn.mjTRN_TENDON:
            quantity, unit = "force on a tendon, negative pulls", "N"
        elif target == mujoco.mjtTrn.mjTRN_JOINT:
            joint = model.actuator_trnid[actuator, 0]
            hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
            quantity, unit = ("torque", "N m") if hinge else ("force", "N")
            quantity += f" on {model.joint(joint).name}"
        else:
            factor = 1.0
    kind = {"index": actuator, "name": model.actuator(actuator).name, "kind": "motor", "quantity": quantity}
    return kind | {"unit": unit, "low": factor * float(low), "high": factor * float(high)}


def _reward(spec: TaskSpec, effects: Sequence[Effect]) -> dict[str, Any]:
    """Return the terms, and their sum as a formula."""
    terms = (*spec.reward_terms(), *(term for effect in effects for term in effect.terms))
    parts = [
        term.name if term.weight == 1.0 else f"{term.weight:g} {term.name}" for term in terms if term.weight
    ]
    formula = "reward = " + " + ".join(parts).replace("+ -", "- ")
    return {"formula": formula, "terms": [{key: getattr(term, key) for key in SAID} for term in terms]}


def _resets(scene: Scene) -> dict[str, Any]:
    """Return what episodes start from under each reset; `own` is that of the id."""
    spec = scene.spec
    texts = dict(RESETS) | {"fixed": spec.start_doc}
    texts["task"] = ", ".join(draw.doc for draw in spec.draws if draw.when == "posture") or spec.start_doc
    if spec.carried:
        texts["random"] += f"; {', '.join(spec.carried)} carried along"
    kinds = {}
    for name, text in texts.items():
        drawn = [draw.name for draw in spec.draws if draw.varies and draw.when in DRAWN_IN[name]]
        kinds[name] = {"start": text, "draws": drawn}
    return {"own": scene.reset, "kinds": kinds}


def _draw(draw: Draw, model: mujoco.MjModel) -> dict[str, Any]:
    """Return what is drawn, number by number."""
    about = {"name": draw.name, "doc": draw.doc, "when": draw.when, "varies": draw.varies}
    low, high = draw.low, draw.high
    if draw.choices:
        return about | {"choices": list(draw.choices)}
    if low:
        names = entries(draw.names or (draw.name,), draw.unit, model)
    else:
        scalar = np.isin(model.jnt_type, POINT_JOINTS) & (model.jnt_range[:, 0] < model.jnt_range[:, 1])
        names = of_joints(model, np.flatnonzero(scalar))
        low, high = model.jnt_range[scalar].T
    rows = [
        entry._asdict() | {"low": float(a), "high": float(b)}
        for entry, a, b in zip(names, low, high, strict=True)
    ]
    return about | {"entries": rows}


def _body(scene: Scene) -> dict[str, Any]:
    """Return joints with ranges, and the sites at the ends."""
    model, body = scene.oracle, BODIES[scene.spec.body]
    followed = {tie.joint: tie.driver for tie in couplings(model)}
    joints = []
    for i in range(model.njnt):
        kind = mujoco.mjtJoint(model.jnt_type[i])
        joint: dict[str, Any] = {"name": model.joint(i).name or str(i)}
        joint["type"] = kind.name.removeprefix("mjJNT_").lower()
        if kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            joint["unit"] = "rad" if kind == mujoco.mjtJoint.mjJNT_HINGE else "m"
            low, high = map(float, model.jnt_range[i])
            joint["range"] = [low, high] if low < high else None
        if i in followed:
            joint["follows"] = model.joint(followed[i]).name if followed[i] >= 0 else "nothing: it is fixed"
        joints.append(joint)
    return {
        "name": scene.spec.body,
        "doc": body.doc,
        "joints": joints,
        "tips": list(body.tips),
        "palm": body.palm,
    }


def _muscles(muscles: MuscleModel, body: Body) -> dict[str, Any]:
    """Return the muscle model, and each muscle's parameters."""
    geometry = muscles.geometry()
    given = {name: getattr(geometry, name)[0] for name in MUSCLE_PARAMETERS}
    given = {name: values for name, values in given.items() if not np.isnan(values).any()}
    rows = [
        {"name": name, "group": body.group_of(name)}
        | {key: float(values[i]) for key, values in given.items()}
        for i, name in enumerate(muscles.names)
    ]
    law = [
        kind for kind in type(muscles).__mro__ if issubclass(kind, MuscleModel) and kind is not MuscleModel
    ][-1]
    units = {name: MUSCLE_PARAMETERS[name] for name in given}
    return {"model": _first_paragraph(inspect.getmodule(law) or law), "units": units, "muscles": rows}


def _condition(condition: Condition, effect: Effect) -> dict[str, Any]:
    """Return what a condition is, with its parameters."""
    documented = attributes_of(type(condition))
    parameters = [
        {
            "name": field.name,
            "value": _plain(getattr(condition, field.name)),
            "doc": documented.get(field.name, ""),
        }
        for field in dataclasses.fields(condition)  # type: ignore[arg-type]  # its subclasses are dataclasses
    ]
    module = inspect.getmodule(type(condition))
    return {
        "name": condition.name,
        "doc": _first_paragraph(module or type(condition)),
        "acts_on": condition.PHASE.name.lower(),
        "parameters": parameters,
        "info": list(effect.info),
    }


def _first_paragraph(thing: object) -> str:
    """Return the first paragraph of a docstring in one line."""
    return " ".join((inspect.getdoc(thing) or "").split("\n\n")[0].split())


def _plain(value: object) -> object:
    """Return a condition's parameter as JSON can have it."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            type(value).__name__: {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        }
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value
