"""Muscles of converted models beside live OpenSim 4.6: static forces, fiber velocities, motions.

    make opensim-check MODELS="../shared/osim/arm26.osim ../shared/osim/gait10dof18musc.osim"
    python -m benchmarks.opensim_muscles MODEL.osim ... --python .venv-opensim/bin/python

Static: tendon force of `muscle="opensim"` fed with OpenSim's length, so that paths are not in it, at six
activations and 40 random poses, and the same law in float64. Velocity: of fibers up to 0.5 % off their
equilibrium, where OpenSim's equation has a solution. Forward: 0.5 s from the default pose at rest, three
patterns of excitation, OpenSim at 1e-6; own muscles and MuJoCo's on converted paths, so that what both are
off is the paths' share. Writes benchmarks/results/opensim_muscles.json after each model.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from myowarp.apps.reports import panel
from myowarp.definitions.muscle import MUSCLES
from myowarp.muscle import Muscles
from myowarp.opensim import convert
from myowarp.sim.build import compile_scene
from myowarp.sim.present import settle_muscles
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import from_mjcf

RESULT = Path(__file__).parent / "results" / "opensim_muscles.json"
PICTURE = Path(__file__).parents[1] / "docs" / "pictures" / "opensim_muscles.png"
LIVE = Path(__file__).parent / "opensim_live.py"
LAWS = {
    "Thelen2003Muscle": "thelen2003",
    "Millard2012EquilibriumMuscle": "millard2012",
    "DeGrooteFregly2016Muscle": "degroote_fregly2016",
}
EVERY, HELD = 0.01, 0.05  # s, as in opensim_live.py
FAR = 1e6
"""Pose error at which an episode ends early: none does."""
ENDS = ((0, -np.inf), (1, np.inf))
OUT = 1e-3  # rad or m beyond a range
FAR_OFF = 1e-4
SOLVED = 0.85
"""Of the maximum contraction velocity: beyond, OpenSim's inverse of the curve is another one."""


def worst(error: np.ndarray, names: list[str]) -> dict[str, Any]:
    """Return the greatest error of arrays (..., muscles), whose it is, and how many are beyond 1e-4."""
    error = error.reshape(-1, error.shape[-1])
    each = np.nanmax(error, axis=0)
    found = {"worst": float(each.max()), "muscle": names[int(each.argmax())]}
    if (beyond := error > FAR_OFF).any():
        found |= {"beyond 1e-4": int(beyond.sum()), "worst of the others": float(np.nanmax(error[~beyond]))}
    return found


def on_device(task: Any, record: Any, meta: dict[str, Any]) -> np.ndarray:
    """Return static tendon forces [F_max] of what runs, in float32, at OpenSim's lengths."""
    length, activation = record["length"], record["activation"]
    poses, acts = len(length), len(activation)
    scene = compile_scene(task, poses * acts, device="cpu", physics="parity", muscle="opensim")
    muscles = scene.muscles
    order = [meta["muscles"].index(name) for name in muscles.names]
    paths = np.repeat(length[:, order], acts, axis=0)
    wp.copy(
        muscles.activation, wp.array(np.tile(activation, poses)[:, None] * np.ones(len(order)), dtype=float)
    )
    wp.copy(muscles.length, wp.array(paths, dtype=float))
    muscles.velocity.zero_()
    muscles.settle(wp.ones(poses * acts, dtype=bool))
    full = np.zeros((len(paths), scene.oracle.nu))
    full[:, muscles.actuator_id] = paths
    zeros = wp.zeros(full.shape, dtype=float)
    data = SimpleNamespace(actuator_length=wp.array(full, dtype=float), actuator_velocity=zeros, ctrl=zeros)
    opt = SimpleNamespace(timestep=wp.zeros(1, dtype=float))
    forms = wp.zeros(full.shape, dtype=wp.types.vector(10, float))
    muscles.launch(SimpleNamespace(opt=opt, actuator_biasprm=forms), data)
    found = np.full((poses, acts, length.shape[1]), np.nan)
    found[:, :, order] = muscles.tension.numpy().reshape(poses, acts, -1)
    return found


def static(task: Any, record: Any, meta: dict[str, Any]) -> dict[str, Any]:
    """Return errors of static forces and fiber velocities, and the number of samples."""
    names, peak = meta["muscles"], np.array([p["max_isometric_force"] for p in meta["parameters"]])
    slack = np.array([p["tendon_slack_length"] for p in meta["parameters"]])
    expected = record["tendon_force"] / peak
    degroote = np.array([kind.startswith("DeGroote") for kind in meta["classes"]])
    out = (degroote & (record["length"] <= slack))[:, None] | np.isnan(expected)
    single = np.where(out, np.nan, on_device(task, record, meta) / peak - expected)
    double, velocity, force = np.full(expected.shape, np.nan), np.full((1, len(names)), np.nan), 0.0
    for i, (kind, p) in enumerate(zip(meta["classes"], meta["parameters"], strict=True)):
        known = MUSCLES[LAWS[kind]].PARAMETERS
        muscle = Muscles(LAWS[kind], **{name: value for name, value in p.items() if name in known})
        a, length = np.meshgrid(record["activation"], record["length"][:, i])
        held = muscle.equilibrium(a[..., None], length[..., None]).tendon_force[..., 0] / peak[i]
        double[:, :, i] = np.where(out[:, :, i], np.nan, held - expected[:, :, i])
        if p.get("ignore_tendon_compliance"):
            continue
        a, length, fiber, speed, tension = record["moving"][:, :, i].T[:, :, None]
        scale = p["optimal_fiber_length"] * p["max_contraction_velocity"]
        moved = muscle.contraction(a, length, 0.0, fiber)
        inside = (np.abs(speed) < SOLVED * scale) & (length > slack[i])
        if inside.any():
            velocity[0, i] = np.abs(moved.fiber_velocity - speed)[inside].max() / scale
            force = max(force, float(np.abs(moved.tendon_force - tension)[inside].max() / peak[i]))
    return {
        "samples": int(np.isfinite(single).sum()),
        "tendon force, float32": worst(np.abs(single), names),
        "tendon force, float64": worst(np.abs(double), names),
        "fiber velocity, float64 [maximum contraction velocities]": worst(velocity, names),
        "tendon force off the equilibrium, float64": force,
    }


def forward(folder: Path, record: Any, meta: dict[str, Any], muscle: str) -> dict[str, Any]:
    """Return how far coordinates are from OpenSim's, by pattern; angles in degrees, slides in mm.

    A range stops our joints and not OpenSim's coordinates: what comes after OpenSim left one does not count.
    """
    task = from_mjcf(folder / "model.xml", far=FAR, control_dt=EVERY, horizon=10_000, replace=True)
    names = [name for name in record if name.startswith("forward ")]
    sim = Simulation(task, len(names), device="cpu", muscle=muscle, autoreset="disabled", progress=False)
    scene, entries = sim.scene, json.loads((folder / "coordinates.json").read_text())
    free = [e for e in entries["coordinates"] if e["kind"] == "free" and e["joint"]]
    joints = np.array([scene.oracle.joint(e["joint"]).qposadr[0] for e in free])
    hinge = np.array([scene.oracle.joint(e["joint"]).type[0] == 3 for e in free])
    scale = np.array([e["scale"] for e in free])
    ids = np.array([scene.oracle.joint(e["joint"]).id for e in free])
    limited = scene.oracle.jnt_limited[ids].astype(bool)
    columns = [meta["coordinates"].index(e["name"]) for e in free]
    order = [meta["muscles"].index(name) for name in scene.muscles.names]
    sim.reset(seeds=np.zeros(len(names), int))
    start = np.tile(scene.oracle.key_qpos[0] if scene.oracle.nkey else scene.oracle.qpos0, (len(names), 1))
    scene.data.qpos.assign(start.astype(np.float32))
    scene.data.qvel.zero_()
    with wp.ScopedDevice(scene.device):
        if scene.muscles.settles:
            settle_muscles(scene, wp.ones(len(names), dtype=bool))
    action = np.zeros(sim.action.shape, np.float32)
    places = scene.muscles.actuator_id
    steps, errors = len(record[names[0]]) - 1, []
    for step in range(steps):
        for world, name in enumerate(names):
            u = record[name.replace("forward", "excitation")][
                min(int((step * EVERY + 1e-9) / HELD), 9), order
            ]
            action[world, places] = 0.5 + np.log(u / (1.0 - u)) / 5.0
        sim.action.assign(action)
        sim.step()
        found = scene.data.qpos.numpy()[:, joints] / scale
        theirs = np.array([record[name][step + 1][columns] for name in names])
        errors.append(np.abs(found - theirs) * np.where(hinge, 180.0 / np.pi, 1e3))
    sim.close()
    error = np.array(errors)
    low, high = (np.where(limited, scene.oracle.jnt_range[ids].T[i] / scale, way) for i, way in ENDS)
    result: dict[str, Any] = {}
    for world, name in enumerate(names):
        theirs = record[name][1:, columns]
        beyond = ((theirs < low - OUT) | (theirs > high + OUT)).any(axis=1)
        inside = int(beyond.argmax()) if beyond.any() else steps
        if not inside:
            result[name.removeprefix("forward ")] = {"until [s]": 0.0}
            continue
        own = error[:inside, world]
        where = int(own.max(axis=0).argmax())
        result[name.removeprefix("forward ")] = {
            "until [s]": round(inside * EVERY, 3),
            "median": float(np.median(own)),
            "worst": float(own.max()),
            "coordinate": free[where]["name"],
            "its motion": float(np.ptp(theirs[:inside, where]) * (180.0 / np.pi if hinge[where] else 1e3)),
        }
    return result


def check(source: Path, python: str, work: Path) -> dict[str, Any]:
    """Return all figures of a model."""
    folder, live = work / source.stem, work / f"{source.stem}.npz"
    subprocess.run([python, str(LIVE), str(source), "-o", str(live)], check=True)
    if not (folder / "report.json").is_file():
        convert.run(source, folder)
    record = dict(np.load(live))
    meta = json.loads(str(record.pop("meta")))
    task = from_mjcf(folder / "model.xml", replace=True)
    report = json.loads((folder / "report.json").read_text())
    row: dict[str, Any] = {"opensim": meta["opensim"], "muscles": len(meta["muscles"])}
    with wp.ScopedDevice("cpu"):
        row |= static(task, record, meta)
    row["joint torque of all muscles"] = {
        name: report["torques"]["summary"].get(name) for name in ("path", "muscle", "both")
    }
    if "no forward simulation" in meta:
        row["forward"] = meta["no forward simulation"]
    else:
        row["forward"] = {name: forward(folder, record, meta, name) for name in ("opensim", "mujoco")}
        row["seconds of OpenSim"] = {
            name: float(value) for name, value in record.items() if name.startswith("seconds")
        }
    return row


def draw(result: dict[str, Any]) -> None:
    """Draw median errors of the motions, a panel for own muscles beside MuJoCo's, dots for the patterns."""
    models = {name: row["forward"] for name, row in result["models"].items() if "opensim" in row["forward"]}
    with panel.style(9.0):
        figure = panel.blank(7.2, 0.5 * len(models) + 1.5)
        axes = figure.subplots()
        for shift, kind, color, label in (
            (-0.17, "mujoco", "#b9a3d6", "MuJoCo's fitted muscles"),
            (0.17, "opensim", "#2f76b5", "own muscles"),
        ):
            each = [[run.get("median", np.nan) for run in row[kind].values()] for row in models.values()]
            places = np.arange(len(models)) + shift
            axes.barh(places, np.nanmean(each, axis=1), 0.3, color=color, label=label)
            for place, values in zip(places, each, strict=True):
                axes.plot(values, np.full(len(values), place), "k.", markersize=4)
        axes.set_yticks(np.arange(len(models)), list(models))
        axes.invert_yaxis()
        axes.set_xlabel("median distance from OpenSim's motion in 0.5 s [degrees, of slides mm]")
        axes.set_title("Converted models beside OpenSim: mean of three patterns, dots each")
        axes.set_xlim(0.0, 1.45 * axes.get_xlim()[1])
        axes.legend(loc="center right")
        panel.save(figure, PICTURE, dpi=120)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--python", default=".venv-opensim/bin/python", help="interpreter with opensim")
    parser.add_argument("--work", type=Path, help="folder for conversions, which are kept there")
    options = parser.parse_args()
    result = json.loads(RESULT.read_text()) if RESULT.is_file() else {"models": {}}
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        for source in options.models:
            result["models"][source.stem] = check(source, options.python, work)
            print(source.stem, json.dumps(result["models"][source.stem], indent=1), flush=True)
            RESULT.write_text(json.dumps(result, indent=1) + "\n")
    draw(result)


if __name__ == "__main__":
    main()
