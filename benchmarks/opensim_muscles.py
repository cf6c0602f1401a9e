"""Models of OpenSim beside live OpenSim 4.6: static forces, joint torques, fiber velocities, motions.

    make opensim-check MODELS="../shared/osim/arm26.osim ../shared/osim/gait10dof18musc.osim"
    python -m benchmarks.opensim_muscles MODEL.osim ... --python .venv-opensim/bin/python

Static: tendon force of `muscle="opensim"` fed with OpenSim's length, so that paths are not in it, at six
activations and 40 random poses, and the same law in float64. Samples in which OpenSim leaves a fiber off its
equilibrium, so that it moves by itself, are counted and left out. Velocity: of fibers up to 0.5 % off their
equilibrium, where OpenSim's equation has a solution. Joint torque: of all muscles, the model as
`myowarp.from_osim` loads it, through the physics step, at the same activations in 40 other random poses over
full ranges; poses in which the guard refuses a jump of OpenSim are counted and left out. Forward: 0.5 s from
the default pose at rest, three patterns of excitation and the least one, OpenSim at 1e-6; the model as it is
loaded at its own step of 2 ms and at shorter ones, so that the step's share is seen; its muscles on fitted
tendons, for what paths do; MuJoCo's muscles on OpenSim's paths, for what muscles do. Ranges stop no joint
(`stops=False`), as in OpenSim. A path may jump in OpenSim, mostly beyond ranges; what comes before is
compared once more. Writes benchmarks/results/opensim_muscles.json after each model.
"""

import argparse
import dataclasses
import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from myowarp.apps.reports import panel
from myowarp.coordinates.step import step_of
from myowarp.definitions.muscle import MUSCLES
from myowarp.inks import BLUE, PINK
from myowarp.laws.muscles.hill_law import OPENSIM_LAWS
from myowarp.muscle import Muscles
from myowarp.osim.body.path_solution import lengths_and_moment_arms
from myowarp.osim.bundle.coordinate_map import CoordinateMap
from myowarp.osim.convert import run as convert
from myowarp.osim.convert.load import load
from myowarp.osim.document.read.model import read_model
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.sim.converted_step import OurStep
from myowarp.sim.present import settle_muscles
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import from_mjcf, from_osim

RESULT = Path(__file__).parent / "results" / "opensim_muscles.json"
PICTURE = Path(__file__).parents[1] / "docs" / "pictures" / "opensim_muscles.png"
LIVE = Path(__file__).parent / "opensim_live.py"
LAWS: Mapping[str, str] = {
    "Thelen2003Muscle": "thelen2003",
    "Millard2012EquilibriumMuscle": "millard2012",
    "DeGrooteFregly2016Muscle": "degroote_fregly2016",
}
"""Classes whose laws are functions in float64, too (`myowarp.muscle`)."""
EVERY, HELD, SECONDS = 0.01, 0.05, 0.5  # s, as in opensim_live.py
FAR = 1e6
"""Pose error at which an episode ends early: none does."""
DEGREES = 180.0 / np.pi
FAR_OFF = 1e-4
MOVES = 1e-4
"""Of the maximum contraction velocity: a fiber that should rest."""
WEAK = 1e-3
"""N m or N: a coordinate about which muscles never do more has no torque."""
JUMP = 0.01
"""m."""
SHORTER = 1e-3, 2.5e-4
"""s: shorter physics steps."""
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
    astray = np.where(out, 0.0, np.abs(record["static_velocity"])) > MOVES
    difference = on_device(task, record, meta) / peak - expected
    apart = np.where(astray, np.abs(difference), 0.0)
    out |= astray
    single = np.where(out, np.nan, difference)
    double, velocity, force = np.full(expected.shape, np.nan), np.full((1, len(names)), np.nan), 0.0
    for i, (kind, p) in enumerate(zip(meta["classes"], meta["parameters"], strict=True)):
        if kind not in LAWS:
            continue
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
    left_out = {"samples": int(astray.sum())} | (worst(apart, names) if astray.any() else {})
    found = {
        "samples": int(np.isfinite(single).sum()),
        "OpenSim's fibers off their equilibrium": left_out,
        "tendon force, float32": worst(np.abs(single), names),
    }
    if not np.isfinite(double).any():
        return found
    return found | {
        "tendon force, float64": worst(np.abs(double), names),
        "fiber velocity, float64 [maximum contraction velocities]": worst(velocity, names),
        "tendon force off the equilibrium, float64": force,
    }


def torques(source: Path, record: Any, meta: dict[str, Any]) -> dict[str, Any]:
    """Return errors of joint torques of all muscles through the step, as shares of OpenSim's.

    Both are root mean squares over poses and activations.
    """
    expected, free = record["torque"], record["torque free"].tolist()
    poses, acts, _ = expected.shape
    coordinates = CoordinateMap.read(load(source).with_name("coordinates.json"))
    scene = compile_scene(from_osim(source), poses * acts, device="cpu", physics="parity")
    data, muscles = scene.data, scene.muscles
    scene.model.callback.control = muscles.launch
    launch = step_of(stepped_of(scene)).launches()
    given = dict(zip(meta["coordinates"], record["torque values"].T, strict=True))
    values = {name: np.repeat(given[name], acts) for name in free}
    qpos, slope = coordinates.rates(scene.oracle, values)
    data.qpos.assign(qpos)
    data.qvel.zero_()
    activation = np.tile(record["activation"], poses)[:, None] * np.ones(len(muscles.names))
    muscles.activation.assign(activation)
    settle_muscles(scene, wp.ones(poses * acts, dtype=bool))
    ctrl = np.zeros(data.ctrl.shape, np.float32)
    ctrl[:, muscles.actuator_id] = activation
    data.ctrl.assign(ctrl)
    launch()
    order = [free.index(name) for name in coordinates.free()]
    found = np.zeros_like(expected)
    found[:, :, order] = np.einsum("nij,ni->nj", slope, data.qfrc_actuator.numpy()).reshape(poses, acts, -1)
    refused = np.zeros((poses, acts), bool)
    if scene.paths:
        refused = (scene.paths.memory.pulls.jumps.numpy() > 0).any(axis=1).reshape(poses, acts)
    kept = np.isfinite(expected).all(axis=2) & ~refused
    error, theirs = (found - expected)[kept], expected[kept]
    acting = np.abs(theirs).max(axis=0) > WEAK
    share = np.sqrt(np.mean(error**2, axis=0)[acting] / np.mean(theirs**2, axis=0)[acting])
    names = [name for name, acts_on in zip(free, acting, strict=True) if acts_on]
    return {
        "samples": int(kept.sum()),
        "refused as jumps": int(refused.sum()),
        "no equilibrium in OpenSim": int(np.isnan(expected).any(axis=2).sum()),
        "mean": float(share.mean()),
        "worst": float(share.max()),
        "coordinate": names[int(share.argmax())],
        "greatest error [N m or N]": float(np.abs(error).max()),
    }


def jumps(source: Path, record: Any, meta: dict[str, Any]) -> dict[str, tuple[int, str, float]]:
    """Return where a path first jumps in each of OpenSim's motions: sample, muscle, and by how much [m].

    A path jumps where its length changes between two samples by `JUMP` more than its moment arms say. Motions
    in which none does are left out.
    """
    model, found = read_model(source), {}
    free, names = model.independent, meta["muscles"]
    paths = {name: model.muscles[name].path for name in names}
    for title in (name for name in record if name.startswith("forward ")):
        values = dict(zip(meta["coordinates"], record[title].T, strict=True))
        q = np.stack([values[name] for name in free], axis=1)
        path = lengths_and_moment_arms(model, paths, {name: values[name] for name in free}, np.zeros_like(q))
        arm = 0.5 * (path.moment_arm[1:] + path.moment_arm[:-1])
        left = np.diff(path.length, axis=0) + np.einsum("kmj,kj->km", arm, np.diff(q, axis=0))
        for sample, muscle in np.argwhere(np.abs(left) > JUMP)[:1]:
            found[title] = int(sample), names[muscle], float(left[sample, muscle])
    return found


def fitted_tendons(file: Path) -> Path:
    """Return a copy of a model, sidecars beside it, whose muscles pull tendons fitted to OpenSim's paths."""
    folder = file.parent.with_name(f"{file.parent.name}-fitted")
    shutil.copytree(file.parent, folder, dirs_exist_ok=True)
    (folder / "paths.json").unlink(missing_ok=True)
    return folder / file.name


def forward(
    file: Path,
    record: Any,
    meta: dict[str, Any],
    jumping: dict[str, tuple[int, str, float]],
    muscle: str | None,
    step: float | None = None,
) -> dict[str, Any]:
    """Return how far coordinates are from OpenSim's, by pattern; angles in degrees, slides in mm.

    Muscles and physics step are the file's if none are given. `jumping` is what `jumps` returned: samples
    before that are compared once more.
    """
    task = from_mjcf(file, stops=False, far=FAR, control_dt=EVERY, horizon=10_000, replace=True)
    if step is not None:
        task = dataclasses.replace(task, physics_dt=step, num_substeps=round(EVERY / step))
    names = [name for name in record if name.startswith("forward ")]
    sim = Simulation(task, len(names), device="cpu", muscle=muscle, autoreset="disabled", progress=False)
    scene = sim.scene
    coordinates = CoordinateMap.read(file.with_name("coordinates.json")).coordinates
    free = [one for one in coordinates if one.kind == "free" and one.joint]
    names_of = [one.name for one in free]
    shown = [scene.oracle.joint(str(one.joint)) for one in free]
    joints = np.array([joint.qposadr[0] for joint in shown])
    hinge = np.array([joint.type[0] == 3 for joint in shown])
    scale = np.array([one.scale for one in free])
    columns = [meta["coordinates"].index(name) for name in names_of]
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
    lengths = [len(record[name]) - 1 for name in names]  # one that took OpenSim long may have ended early
    steps, errors = max(lengths), []
    for number in range(steps):
        for world, name in enumerate(names):
            u = record[name.replace("forward", "excitation")][
                min(int((number * EVERY + 1e-9) / HELD), 9), order
            ]
            action[world, places] = 0.5 + np.log(u / (1.0 - u)) / 5.0
        sim.action.assign(action)
        sim.step()
        found = scene.data.qpos.numpy()[:, joints] / scale
        theirs = np.array([record[name][min(number + 1, len(record[name]) - 1)][columns] for name in names])
        errors.append(np.abs(found - theirs) * np.where(hinge, DEGREES, 1e3))
    sim.close()
    error = np.array(errors)
    result: dict[str, Any] = {}
    for world, name in enumerate(names):
        motion = record[name][1:, columns] * np.where(hinge, DEGREES, 1e3)
        row = of_kinds(error[: lengths[world], world], motion, names_of, hinge)
        if lengths[world] < round(SECONDS / EVERY):
            row["seconds"] = round(lengths[world] * EVERY, 3)
        if name in jumping:
            sample, which, jump = jumping[name]
            row["until a path jumps"] = {
                "time [s]": round(sample * EVERY, 3),
                "muscle": which,
                "jump [mm]": 1e3 * jump,
                **(of_kinds(error[:sample, world], motion[:sample], names_of, hinge) if sample else {}),
            }
        result[name.removeprefix("forward ")] = row
    return result


def of_kinds(error: np.ndarray, motion: np.ndarray, names: list[str], hinge: np.ndarray) -> dict[str, Any]:
    """Return the errors of angles and of slides."""
    return {
        title: summary(error, np.ptp(motion, axis=0), names, chosen)
        for title, chosen in (("angles [degrees]", hinge), ("slides [mm]", ~hinge))
        if chosen.any()
    }


def summary(error: np.ndarray, moved: np.ndarray, names: list[str], chosen: np.ndarray) -> dict[str, Any]:
    """Return median and worst of errors (times, coordinates) among some of these, and whose it is."""
    where = int(np.where(chosen, error.max(axis=0), -1.0).argmax())
    return {
        "median": float(np.median(error[:, chosen])),
        "worst": float(error[:, where].max()),
        "coordinate": names[where],
        "its motion": float(moved[where]),
    }


def check(source: Path, python: str, work: Path) -> dict[str, Any]:
    """Return all figures of a model."""
    folder, live = work / source.stem, work / f"{source.stem}.npz"
    if not live.is_file() or live.stat().st_mtime < LIVE.stat().st_mtime:
        subprocess.run([python, str(LIVE), str(source), "-o", str(live)], check=True)
    if not (folder / "report.json").is_file():
        convert.run(source, folder, OurStep)
    record = dict(np.load(live))
    meta = json.loads(str(record.pop("meta")))
    task = from_mjcf(folder / "model.xml", replace=True)
    row: dict[str, Any] = {"opensim": meta["opensim"], "muscles": len(meta["muscles"])}
    with wp.ScopedDevice("cpu"):
        if lawless := sorted(set(meta["classes"]) - set(OPENSIM_LAWS)):
            row["classes without a law here"] = lawless
        else:
            row |= static(task, record, meta)
        row["joint torque of all muscles"] = torques(source, record, meta)
    if "no forward simulation" in meta:
        row["forward"] = meta["no forward simulation"]
    else:
        row["forward"], jumping = {}, jumps(source, record, meta)
        loaded, converted = load(source), folder / "model.xml"
        fitted = fitted_tendons(converted)
        for title, file, muscle, step in (
            ("opensim", loaded, None, None),
            *((f"opensim, {1e3 * step:g} ms", loaded, None, step) for step in SHORTER),
            ("opensim, fitted tendons", fitted, "opensim", None),
            ("mujoco", converted, "mujoco", None),
        ):
            row["forward"][title] = forward(file, record, meta, jumping, muscle, step)
        row["seconds of OpenSim"] = {
            name: float(value) for name, value in record.items() if name.startswith("seconds")
        }
    return row


def median_of(run: dict[str, Any]) -> float:
    """Return the median of a motion's angles, of its slides where it has none."""
    of = run.get("angles [degrees]", run.get("slides [mm]"))
    return of["median"] if of else np.nan


def draw(result: dict[str, Any]) -> None:
    """Draw median errors of the motions, a panel for own muscles beside MuJoCo's, dots for the patterns."""
    models = {
        name: row["forward"]
        for name, row in result["models"].items()
        if "opensim" in row["forward"]
        and not any("seconds" in run for run in row["forward"]["opensim"].values())
    }
    with panel.style(9.0):
        figure = panel.blank(7.2, 0.5 * len(models) + 1.5)
        axes = figure.subplots()
        for shift, kind, color, label in (
            (-0.17, "mujoco", PINK, "MuJoCo's fitted muscles"),
            (0.17, "opensim", BLUE, "own muscles"),
        ):
            each = [[median_of(run) for run in row[kind].values()] for row in models.values()]
            places = np.arange(len(models)) + shift
            axes.barh(places, np.nanmean(each, axis=1), 0.3, color=color, label=label)
            for place, values in zip(places, each, strict=True):
                axes.plot(values, np.full(len(values), place), "k.", markersize=4)
        axes.set_yticks(np.arange(len(models)), list(models))
        axes.invert_yaxis()
        axes.set_xlabel("median distance from OpenSim's motion in 0.5 s [degrees, of slides mm]")
        axes.set_title("Models beside OpenSim: mean of the motions, a dot for each")
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
    parser.add_argument(
        "--work", type=Path, help="folder for conversions and recordings, which are kept there"
    )
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
