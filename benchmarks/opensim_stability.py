"""Are converted models stable? 10 s from the key pose and from `mj_resetData`, in MuJoCo C and in MyoWarp.

    python -m benchmarks.opensim_stability OUT/arm26 OUT/gait10dof18musc ... ../shared/osim/arm26.osim ...

Folders are those that `myowarp convert` wrote. MuJoCo C steps model.mjb by 2 ms, without and with excitations
that are drawn anew every 20 ms; what counts are MuJoCo's warnings of a state that is not a number or huge.
MyoWarp steps model.xml with its sidecars in two worlds, without and with such excitations, in one episode;
then in 16 worlds for 1,000 control steps from its task's own starts, with all actuators and with muscles
alone. What counts are faults. An .osim file is loaded as it is, and stepped by MyoWarp alone. Writes
benchmarks/results/opensim_stability.json, after each model.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from myowarp.osim.convert.load import load
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import from_mjcf

RESULT = Path(__file__).parent / "results" / "opensim_stability.json"
SECONDS, HELD = 10.0, 0.02
WORLDS, STEPS = 16, 1_000
FAR = 1e6
"""Pose error at which an episode ends early: none does."""
WARNINGS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


def in_mujoco(path: Path, start: str, excited: bool) -> dict[str, Any]:
    """Return when model.mjb fails [s], None if never, and the greatest speed until then [rad/s or m/s]."""
    model = mujoco.MjModel.from_binary_path(str(path / "model.mjb"))
    data, rng, top = mujoco.MjData(model), np.random.default_rng(0), 0.0
    if start == "key":
        mujoco.mj_resetDataKeyframe(model, data, 0)
    motor = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
    low = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange[:, 0], -1.0 * motor)
    high = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange[:, 1], 1.0)
    each = round(HELD / model.opt.timestep)
    for step in range(round(SECONDS / model.opt.timestep)):
        if excited and step % each == 0:
            data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data)
        if any(data.warning[int(kind)].number for kind in WARNINGS):
            return {"failed_at_s": round(step * model.opt.timestep, 3), "greatest_speed": round(top, 1)}
        top = max(top, float(np.abs(data.qvel).max(initial=0.0)))
    return {"failed_at_s": None, "greatest_speed": round(top, 1)}


def in_myowarp(path: Path, worlds: int, steps: int, excite: str) -> dict[str, Any]:
    """Return number of faults, the first ones [control steps, world], and the greatest speed between steps.

    Args:
        path: The folder, or the .osim file.
        worlds: Number of worlds.
        steps: Control steps, of one episode if there are two worlds.
        excite: "half": the second of two worlds; "muscles"; "all".
    """
    horizon = {"horizon": steps + 1} if excite == "half" else {}
    file = path if path.is_file() else path / "model.xml"
    task = from_mjcf(file, far=FAR, control_dt=HELD, replace=True, **horizon)
    sim = Simulation(task, worlds, device="cpu", autoreset="same_step", progress=False)
    data, rng, top, faults = sim.scene.data, np.random.default_rng(0), 0.0, []
    motor = sim.scene.oracle.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
    sim.reset(seeds=np.arange(worlds))
    for step in range(steps):
        action = rng.uniform(-1.0, 1.0, sim.action.shape).astype(np.float32)
        if excite == "half":
            action[0] = np.where(motor, 0.0, -1.0)
        elif excite == "muscles":
            action[:, motor] = 0.0
        sim.action.assign(action)
        sim.step()
        faults += [(step, int(world)) for world in np.flatnonzero(sim.transition.fault.numpy())]
        top = max(top, float(np.nan_to_num(np.abs(data.qvel.numpy())).max(initial=0.0)))
    sim.close()
    return {"faults": len(faults), "first": faults[:3], "greatest_speed": round(top, 1)}


def stability(path: Path) -> dict[str, Any]:
    """Return all runs of one model."""
    row: dict[str, Any] = {}
    if path.is_file():
        model = mujoco.MjModel.from_xml_path(str(load(path)))
    else:
        model = mujoco.MjModel.from_binary_path(str(path / "model.mjb"))
        for start in ("reset", "key"):
            for excited in (False, True):
                title = f"mujoco, from {start}, {'random excitation' if excited else 'at rest'}"
                row[title] = in_mujoco(path, start, excited)
    row["myowarp, from key, at rest and random excitation"] = in_myowarp(
        path, 2, round(SECONDS / HELD), "half"
    )
    row["myowarp, 16 worlds x 1,000 steps, muscles"] = in_myowarp(path, WORLDS, STEPS, "muscles")
    if (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE).any():
        row["myowarp, 16 worlds x 1,000 steps, muscles and motors"] = in_myowarp(path, WORLDS, STEPS, "all")
    return row


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    options = parser.parse_args()
    result = json.loads(RESULT.read_text()) if RESULT.is_file() else {"models": {}}
    for path in options.models:
        result["models"][path.name] = stability(path)
        print(path.name, json.dumps(result["models"][path.name], indent=1), flush=True)
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
