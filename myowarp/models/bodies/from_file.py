"""A model's file as a body: MJCF such as `myowarp convert` writes, or .osim.

Joints that an equality ties to others follow, exactly if `couplings.json` lies beside the file, and a root
that nothing holds falls. A `muscles.csv` of the converter beside it has the parameters for muscle models
that take those of Hill muscles.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from myowarp.definitions.body import BODIES, CAUTIOUS_STEP, Body
from myowarp.definitions.muscle import muscle_names
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.disk import model_digest
from myowarp.models.bodies import arm_muscles, leg_muscles
from myowarp.osim.bundle.bundle import MUSCLES, Bundle, ForeignPartError
from myowarp.process import warn_once

OPENSIM = ".osim"
STEPPED = ("EULER", "IMPLICITFAST")  # integrators; others call the muscles more than once in a step


def register_body(
    path: Path,
    tips: tuple[str, ...] = (),
    stops: bool = True,
    function_paths: Path | None = None,
    contact: str = "mujoco",
) -> tuple[str, mujoco.MjModel]:
    """Register the model of a file as a body, once; motors without a control range get -1 to 1.

    Args:
        path: MJCF, or a model of OpenSim (.osim); or the name of a body that is registered.
        tips: Names of the sites that tasks show or steer.
        stops: Whether ranges stop joints; a line says which holds in a model of OpenSim, whose own stop none.
        function_paths: As for `load.load`.
        contact: "opensim" has the model's contact forces of OpenSim act in place of MuJoCo's contact.

    Returns:
        Name in `BODIES`; that of a file holds a digest of the compiled model, meshes and includes included,
        because compiled scenes are kept by name. And the model.

    Raises:
        ValueError: The file is no model that MuJoCo reads, or has actuators that we cannot step; a body of
            the package is to have no stops; or OpenSim's contact is asked for, and the model brings none.
    """
    if function_paths is not None and path.suffix.lower() != OPENSIM:
        raise ValueError(f"function_paths are an option of an .osim file; {str(path)!r} is none")
    source, longest = path, np.inf
    if str(path) in BODIES and not path.exists():
        if not stops:
            raise ValueError(f"stops are an option of a model's file; {str(path)!r} is a body with its own")
        if contact == "opensim":
            raise ValueError(f"contact is an option of a model's file; {str(path)!r} is a body with its own")
        body = _with_tips(str(path), tips)
        return body, BODIES[body].build().compile()
    if path.suffix.lower() == OPENSIM:
        from myowarp.osim.convert.load import load  # reading .osim files is not needed at every start

        path = load(path, function_paths, contact)
    try:
        bundle = Bundle.load(path).touching(contact, source)
        spec = bundle.into(bundle.spec)
        # What the file says of it is for MuJoCo C; mujoco-warp has dense Jacobians of small models only.
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_AUTO
        for actuator in spec.actuators:
            if actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE and not np.any(actuator.ctrlrange):
                actuator.ctrlrange = (-1.0, 1.0)
        for joint in spec.joints if not stops else ():
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        model = spec.compile()
        if bundle.contacts is not None:
            longest = bundle.contacts.longest_step(model)
            while spec.option.timestep > longest > 0.0:
                spec.option.timestep *= 0.5
            model.opt.timestep = spec.option.timestep
        model.names.decode()
    except ForeignPartError:
        raise
    except UnicodeDecodeError as error:
        raise ValueError(f"model {str(path)!r} must be written in UTF-8; save it as that") from error
    except ValueError as error:
        reason = " ".join(str(error).split())
        bodies = "" if path.exists() else f"; bodies are {', '.join(BODIES)}"
        raise ValueError(
            f"model {str(path)!r} must be an MJCF file; MuJoCo says: {reason}{bodies}"
        ) from error
    _check(model, source)
    if source.suffix.lower() == OPENSIM:
        _say_stops(model, source, stops)
    if bundle.contacts is not None:
        warn_once(
            f"{source.name}: contact is OpenSim's; physics steps are {1e3 * model.opt.timestep:g} ms, its "
            f"springs stand {1e3 * longest:.2g} ms"
        )
    bundle.check(model, path)
    title = re.sub(r"[^A-Za-z0-9]+", "_", spec.modelname).strip("_")
    name = "_".join((title, model_digest(model)[:8], *tips))
    actuators = [model.actuator(i).name for i in range(model.nu)]
    muscles = MuscleTable.converted(bundle.muscles, actuators, path.with_name(MUSCLES))
    if muscles is not None:
        muscles, moved = muscles.bounded("opensim")
        for change in moved:
            warn_once(f"{source.name}: {change}")
    known = BODIES[name].muscles if name in BODIES else None
    if name not in BODIES or _of(known) != _of(muscles):
        names = muscle_names(model)
        own = own_model(muscles, names)
        step = replace(CAUTIOUS_STEP, dt=min(CAUTIOUS_STEP.dt, longest))
        whole = Body(spec.copy, tips, muscles=muscles, muscle=own, coarse_step=step, **_facts(names))
        BODIES.add(name, whole, replace=True)
    return name, model


def _say_stops(model: mujoco.MjModel, source: Path, stops: bool) -> None:
    """Log whether ranges of a model of OpenSim stop its joints, where it has any that could."""
    if not stops:
        warn_once(f"{source.name}: no range stops a joint, as in OpenSim's simulations")
    elif count := int(model.jnt_limited.sum()):
        warn_once(
            f"{source.name}: {count} clamped joints stop at their ranges, unlike in OpenSim's simulations; "
            "--no-stops, or stops=False, lets them go on"
        )


def _facts(names: list[str]) -> dict[str, Any]:
    """Return groups and fatigue rates of muscles: an arm's, a leg's, or none where most are neither."""
    for known in (arm_muscles, leg_muscles):
        if 2 * sum(name.removesuffix("_r") in known.GROUPS for name in names) > len(names):
            return {"groups": known.GROUPS, "fatigue_rates": known.FATIGUE_RATES}
    return {}


def _of(table: MuscleTable | None) -> Any:
    """Return what a body's table of muscles says."""
    return table and (table.parameters, table.curves)


def _with_tips(name: str, tips: tuple[str, ...]) -> str:
    """Return the name of a body that is registered, with tips of a task in place of its own."""
    if not tips:
        return name
    steered = "_".join((name, *tips))
    if steered not in BODIES:
        BODIES.add(steered, replace(BODIES[name], tips=tips))
    return steered


def own_model(muscles: MuscleTable | None, names: list[str]) -> str:
    """Return the muscle model of a converted model's own muscles, where every one has a law here."""
    if muscles is None or not names:
        return "mujoco"
    laws = muscles.parameters.get("law", {})
    if without := [name for name in names if name not in laws]:
        some = f"{len(without)} of {len(names)} muscles, such as {without[0]!r}"
        instead = "all muscles are MuJoCo's, fitted to their static forces"
        warn_once(f"{some}, are of a class without a law here; {instead}")
        return "mujoco"
    return "opensim"


def _check(model: mujoco.MjModel, path: Path) -> None:
    """Raise ValueError if the model has nothing to act with, or something that we cannot step."""
    if not model.nu:
        raise ValueError(f"model {str(path)!r} has no actuators; a policy needs muscles or motors")
    if not model.opt.timestep > 0.0:
        raise ValueError(f"model {str(path)!r} must have a time step above 0 s, got {model.opt.timestep:g} s")
    if wrong := [name for name, values in _numbers(model) if not np.isfinite(values).all()]:
        raise ValueError(
            f"model {str(path)!r} must have numbers that are finite in float32; "
            f"in {', '.join(wrong)} they are not"
        )
    integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    if integrator not in STEPPED:
        raise ValueError(
            f"model {str(path)!r} has integrator {integrator}; muscles need one of {', '.join(STEPPED)}"
        )
    for what, has in (
        ("a plugin", model.actuator_plugin >= 0),
        ("a delay", model.actuator_delay > 0),
        ("actearly", model.actuator_actearly.astype(bool)),
        ("a disabled group", (model.opt.disableactuator >> model.actuator_group) & 1 > 0),
    ):
        if has.any():
            name = model.actuator(int(np.argmax(has))).name or str(np.argmax(has))
            raise ValueError(f"model {str(path)!r} has actuator {name!r} with {what}, which is not simulated")
    kinds = zip(model.actuator_dyntype, model.actuator_gaintype, model.actuator_biastype, strict=True)
    muscle = (mujoco.mjtDyn.mjDYN_MUSCLE, mujoco.mjtGain.mjGAIN_MUSCLE, mujoco.mjtBias.mjBIAS_MUSCLE)
    for index, kind in enumerate(kinds):
        if kind[0] != mujoco.mjtDyn.mjDYN_NONE and kind != muscle:
            name = model.actuator(index).name or str(index)
            raise ValueError(
                f"model {str(path)!r} has actuator {name!r} with a state that is no MuJoCo muscle; what runs "
                "are MuJoCo's muscles, and actuators without state"
            )


def _numbers(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the names of a model's real numbers, and what they are in float32."""
    for owner in (model, model.opt):
        for name in dir(owner):
            values = None if name.startswith("_") else getattr(owner, name)
            if isinstance(values, np.ndarray) and values.dtype.kind == "f":
                with np.errstate(over="ignore"):
                    yield name, values.astype(np.float32)
