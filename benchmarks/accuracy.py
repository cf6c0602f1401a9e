"""Deviation of a preset's coarse steps from fine ones: joints of the limb, position and tilt of the object.

    make accuracy

Episodes of 0.2 s from each task's start at rest, joints that follow others put where they belong, random
excitations as of a policy through MyoSuite's map, each held for one control step; errors at the ends of
control steps, root mean square over episodes, steps and joints. The reference is MuJoCo C, Euler, 0.1 ms,
float64, contacts included, with hard springs of couplings. Two tables: schemes in MuJoCo C, the model of what
we step, and our engine's presets.
"""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.osim.bundle.couplings import follow
from myowarp.progress import progress_bar
from myowarp.sim.simulation import Simulation
from tests.reference.mujoco_muscle import activation_after, gain

FAMILIES = {
    "elbow pose": "myoElbowPose1D6MFixed-v0",
    "finger pose": "myoFingerPoseFixed-v0",
    "finger reach": "myoFingerReachFixed-v0",
    "hand pose": "myoHandPoseFixed-v0",
    "hand reach": "myoHandReachFixed-v0",
    "key turn": "myoHandKeyTurnFixed-v0",
    "object hold": "myoHandObjHoldFixed-v0",
    "pen twirl": "myoHandPenTwirlFixed-v0",
    "baoding": "myoChallengeBaodingP1-v1",
    "leg stand": "myoLegStandRandom-v0",
    "leg walk": "myoLegWalk-v0",
    "arm reach": "myoArmReachFixed-v0",
    "torso pose": "myoTorsoPoseFixed-v0",
}
SPEED_STEP = 1e-6  # m/s, of central differences
REFERENCE_DT = 1e-4  # s; halving it moves the joints by some 2e-4 rad
HARDEST = 4  # time constant of springs, in steps; MuJoCo takes 2 or more
DURATION = 0.2  # s
STEPS_MS = (1.0, 2.0, 2.5, 3.33, 4.0, 5.0, 6.67, 8.33, 10.0)
MATCH_MS = 0.25  # a step within this of a wanted one stands for it; steps must divide the control step


@dataclass(frozen=True)
class Scheme:
    """A way to step in MuJoCo C.

    Attributes:
        integrator: Name of a `mujoco.mjtIntegrator` member without its prefix.
        midstep: Activation by its closed form, force from its value in the middle of the step.
        implicitness: Share of the muscles' dF/dvelocity that the integrator takes in.
    """

    integrator: str
    midstep: bool = False
    implicitness: float = 1.0

    @property
    def name(self) -> str:
        """Name in tables."""
        parts = [self.integrator.lower()]
        parts += ["mid-step activation"] if self.midstep else []
        parts += [f"{self.implicitness:g} dF/dv"] if self.implicitness != 1.0 else []
        return ", ".join(parts)


SCHEMES = (
    Scheme("EULER"),
    Scheme("EULER", midstep=True),
    Scheme("IMPLICITFAST"),
    Scheme("IMPLICITFAST", midstep=True),
    Scheme("IMPLICITFAST", midstep=True, implicitness=0.6),
    Scheme("IMPLICITFAST", midstep=True, implicitness=0.5),
    Scheme("IMPLICITFAST", midstep=True, implicitness=0.35),
    Scheme("DISCRETE"),
)


@dataclass
class Options:
    """Measure the error of coarse steps."""

    output: Path = Path("out/accuracy.json")
    """JSON file to write."""
    families: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-f"])] = tuple(FAMILIES)
    """Families to measure."""
    episodes: int = 12
    """Episodes of each family."""
    limit: float = 0.02
    """Largest error of the joints that is accepted [rad]."""
    threads: int = 2
    """Threads of MuJoCo C."""


@dataclass
class Study:
    """One family: where its episodes start, what is done in them, and what comes of it in fine steps."""

    key: str
    model: mujoco.MjModel
    starts: np.ndarray
    actions: np.ndarray
    reference: np.ndarray

    def error(self, qpos: np.ndarray) -> dict[str, float]:
        """Return root mean square errors of configurations (num_episodes, num_steps, nq)."""
        model, objects = self.model, self.objects
        hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        limb = model.jnt_qposadr[hinge & ~np.isin(model.jnt_bodyid, objects)]
        figures = {"joints_rad": _rms(qpos[..., limb] - self.reference[..., limb])}
        if objects:
            places = [self._poses(configurations) for configurations in (qpos, self.reference)]
            (position, rotation), (position_ref, rotation_ref) = places
            figures["object_mm"] = 1e3 * _rms(np.linalg.norm(position - position_ref, axis=-1))
            cosine = np.abs(np.sum(rotation * rotation_ref, axis=-1)).clip(max=1.0)
            figures["object_tilt_rad"] = _rms(2.0 * np.arccos(cosine))
        return {name: float(f"{value:.3g}") for name, value in figures.items()}

    @property
    def objects(self) -> list[int]:
        """Bodies that the hand moves."""
        names = TASKS[self.key].carried or (("key",) if "KeyTurn" in self.key else ())
        return [self.model.body(name).id for name in names]

    def _poses(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return position [m] and quaternion of the objects, shape (..., num_objects, 3 or 4)."""
        data = mujoco.MjData(self.model)
        poses = []
        for configuration in qpos.reshape(-1, self.model.nq):
            data.qpos[:] = configuration
            mujoco.mj_kinematics(self.model, data)
            poses.append(np.concatenate([data.xpos[self.objects], data.xquat[self.objects]], axis=1))
        flat = np.array(poses)
        return flat[..., :3], flat[..., 3:]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def excitation_of(action: np.ndarray) -> np.ndarray:
    """Return MyoSuite's excitations of actions."""
    return 1.0 / (1.0 + np.exp(-5.0 * (action - 0.5)))


def episode(
    model: mujoco.MjModel, scheme: Scheme, num_substeps: int, start: np.ndarray, actions: np.ndarray
) -> np.ndarray:
    """Return the configurations at the ends of control steps in MuJoCo C, shape (num_steps, nq)."""
    model, data = model.__copy__(), mujoco.MjData(model)
    data.qpos[:] = start
    bounds, constants = model.actuator_ctrlrange.T, model.actuator_dynprm[:, :2].T
    times = np.arange(2 * num_substeps + 1)[:, None] * 0.5 * model.opt.timestep
    gainprm = model.actuator_gainprm.copy()
    configurations = []
    for action in actions:
        data.ctrl[:] = np.clip(excitation_of(action), *bounds)
        if scheme.midstep:
            activation = activation_after(times, data.ctrl, data.act.copy(), *constants)
            for middle in activation[1::2]:
                data.act[:] = middle
                if scheme.implicitness == 1.0:
                    mujoco.mj_step(model, data)
                else:
                    _step_with_share(model, data, gainprm, scheme.implicitness)
            data.act[:] = activation[-1]
        else:
            mujoco.mj_step(model, data, num_substeps)
        configurations.append(data.qpos.copy())
    return np.array(configurations)


def _step_with_share(
    model: mujoco.MjModel, data: mujoco.MjData, gainprm: np.ndarray, implicitness: float
) -> None:
    """Step with a share of the muscles' dF/dvelocity in the integrator: stateless actuators for one step."""
    mujoco.mj_step1(model, data)
    length, velocity = data.actuator_length, data.actuator_velocity

    def active(speed: np.ndarray) -> np.ndarray:
        return data.act * gain(length, speed, model.actuator_lengthrange, model.actuator_acc0, gainprm)

    mujoco.mj_fwdActuation(model, data)
    slope = (active(velocity + SPEED_STEP) - active(velocity - SPEED_STEP)) / (2.0 * SPEED_STEP)
    bias = model.actuator_biasprm.copy()
    model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gaintype[:] = mujoco.mjtGain.mjGAIN_FIXED
    model.actuator_gainprm[:] = 0.0
    model.actuator_biasprm[:] = 0.0
    model.actuator_biasprm[:, 0] = data.actuator_force - implicitness * slope * velocity
    model.actuator_biasprm[:, 2] = implicitness * slope
    mujoco.mj_step2(model, data)
    model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_MUSCLE
    model.actuator_gaintype[:] = mujoco.mjtGain.mjGAIN_MUSCLE
    model.actuator_gainprm[:], model.actuator_biasprm[:] = gainprm, bias


def run(study: Study, scheme: Scheme, num_substeps: int, threads: int) -> np.ndarray:
    """Return the configurations of all episodes."""
    model = study.model.__copy__()
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{scheme.integrator}")
    model.opt.timestep = TASKS[study.key].control_dt / num_substeps
    with ThreadPoolExecutor(threads) as pool:
        episodes = pool.map(partial(episode, model, scheme, num_substeps), study.starts, study.actions)
        return np.array(list(episodes))


def engine(
    key: str,
    physics: str,
    episodes: int,
    actions: np.ndarray | None = None,
    starts: np.ndarray | None = None,
) -> tuple[Simulation, Any]:
    """Return our engine after episodes of given actions, and the configurations at all ends of steps.

    Episodes begin where the task's do, or in given configurations, at rest. Tasks whose own excitations are
    linear in the action get those that give the same.
    """
    sim = Simulation(
        TASKS[key], episodes, device="cpu", physics=physics, autoreset="disabled", progress=False
    )
    sim.reset(seeds=np.arange(episodes))
    if starts is not None:
        sim.scene.data.qpos.assign(starts)
        sim.scene.data.qvel.zero_()
    configurations = [sim.scene.data.qpos.numpy().copy()]
    for action in [] if actions is None else np.swapaxes(actions, 0, 1):
        given = 2.0 * excitation_of(action) - 1.0 if TASKS[key].linear_excitation else action
        sim.action.assign(given.astype(np.float32))
        sim.step()
        configurations.append(sim.scene.data.qpos.numpy().copy())
    return sim, np.swapaxes(np.array(configurations, dtype=np.float64), 0, 1)


def prepare(key: str, options: Options) -> Study:
    """Return where episodes start, random actions, and the reference."""
    spec = TASKS[key]
    sim, configurations = engine(key, "parity", options.episodes)
    num_steps = round(DURATION / spec.control_dt)
    shape = (options.episodes, num_steps, sim.scene.num_actions)
    actions = np.float32(np.random.default_rng(0).uniform(-1.0, 1.0, shape)).astype(np.float64)
    starts = configurations[:, 0]
    for start in starts:
        follow(sim.scene.oracle, start)
    model = sim.scene.oracle
    # Springs of couplings as hard as the reference can integrate: `fast` has none.
    model.eq_solref[model.eq_type == mujoco.mjtEq.mjEQ_JOINT] = (HARDEST * REFERENCE_DT, 1.0)
    study = Study(key, model, starts, actions, np.empty(0))
    study.reference = run(study, Scheme("EULER"), round(spec.control_dt / REFERENCE_DT), options.threads)
    return study


def substep_counts(control_dt: float) -> list[int]:
    """Return the numbers of physics steps in a control step that come near the wanted steps."""
    counts = {max(1, round(1e3 * control_dt / step)): step for step in STEPS_MS}
    return [n for n, step in counts.items() if abs(1e3 * control_dt / n - step) < MATCH_MS]


def in_c(study: Study, options: Options) -> list[dict[str, Any]]:
    """Return the error of every scheme at every step, in MuJoCo C."""
    control_dt = TASKS[study.key].control_dt
    return [
        {"scheme": scheme.name, "step_ms": round(1e3 * control_dt / n, 2), "substeps": n}
        | study.error(run(study, scheme, n, options.threads))
        for scheme in SCHEMES
        for n in substep_counts(control_dt)
    ]


def in_engine(study: Study) -> list[dict[str, Any]]:
    """Return the error of the presets in our engine."""
    rows = []
    for physics in PHYSICS:
        sim, configurations = engine(study.key, physics, len(study.starts), study.actions, study.starts)
        step = {"step_ms": round(1e3 * float(sim.scene.oracle.opt.timestep), 2)}
        rows.append({"preset": physics} | step | study.error(configurations[:, 1:]))
    return rows


def fewest_steps(rows: list[dict[str, Any]], limit: float) -> dict[str, Any]:
    """Return the scheme with the fewest steps whose joints stay within the limit; then the most accurate.

    The discrete integrator costs two of the others' steps and is not considered.
    """
    fit = [row for row in rows if row["joints_rad"] <= limit and not row["scheme"].startswith("discrete")]
    return min(fit, key=lambda row: (row["substeps"], row["joints_rad"]))


def main() -> None:
    """Measure, print tables, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.accuracy")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    families: dict[str, Any] = {}
    with progress_bar("accuracy", "families") as progress:
        bar = progress.add_task("", total=len(options.families))
        for family in options.families:
            study = prepare(FAMILIES[family], options)
            rows = in_c(study, options)
            families[family] = {
                "task": study.key,
                "fewest_steps_within_limit": fewest_steps(rows, options.limit),
                "myowarp": in_engine(study),
                "mujoco_c": rows,
            }
            progress.advance(bar)
    report = {
        "versions": {name: version(name) for name in ("mujoco", "mujoco-warp", "warp-lang")},
        "reference": f"MuJoCo C, Euler, {1e3 * REFERENCE_DT:g} ms",
        "episodes": options.episodes,
        "duration_s": DURATION,
        "families": families,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    table = Table(
        "family", "preset or scheme", "step [ms]", "joints [rad]", "object [mm]", "object tilt [rad]"
    )
    for family, result in families.items():
        best = result["fewest_steps_within_limit"]
        best = best | {"preset": f"fewest steps in C: {best['scheme']}"}
        for row in (*result["myowarp"], best):
            figures = (
                row.get(name, "") for name in ("step_ms", "joints_rad", "object_mm", "object_tilt_rad")
            )
            table.add_row(family, row["preset"], *(str(figure) for figure in figures))
    Console().print(table)


if __name__ == "__main__":
    main()
