"""Random start configurations of a task: free of penetration, and shown by the engine not to fail at once.

A posture is drawn uniformly within the joint ranges; where geoms touch, only a random subset of the
joints goes there from the task's own start, and part of the way. Objects in the hand go with the palm. A
start is kept if

- no two geoms penetrate each other deeper than they do in the task's own start, in MuJoCo C, and
- the engine, stepping it under zero action, sees neither a failure nor an object that leaves its place,

with the sizes, places and goals of several episodes.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES, POINT_JOINTS
from myowarp.definitions.scene import Starts
from myowarp.definitions.task import TaskSpec
from myowarp.disk import array_bytes, array_from_bytes, cached, code_digest, model_digest
from myowarp.engine.compile import quiet
from myowarp.engine.patch import engine_kernels_alone
from myowarp.osim.bundle.couplings import couplings, follow
from myowarp.process import with_build_lock
from myowarp.progress import patient_bar
from myowarp.sim import palm
from myowarp.sim.build import compile_scene, oracle_model, source_digest
from myowarp.sim.shard import Shard

NUM_STARTS = 1024
BATCH = 256  # starts on trial together
MAX_DRAWS = 400_000
NUM_EPISODES = 16  # draws of sizes, places and goals with which a start has to be a good one
PENETRATION = 1e-4  # m, beyond that of the task's own start
FAIL_STEPS = 5  # control steps that a start has to survive
HOLD_TIME = 0.2  # s that it has to survive where something lies in the hand; a free fall of 0.2 m
HOLD_DISTANCE = 0.03  # m that an object may move in the palm meanwhile; in the own starts it settles by 0.023
PATIENCE = 2.0  # s without a word

SIZES = ("geom_size", "geom_rbound", "geom_aabb")  # fields that are checked at their largest
PLACES = ("body_pos",)


def start_address(spec: TaskSpec, model: mujoco.MjModel) -> np.ndarray:
    """Return the addresses in qpos that a random start sets: posture, what follows it or lies in the hand."""
    carried = [palm.joint_address(model, model.body(name).id) for name in spec.carried]
    posture = [*posture_joints(model, spec.loose), *(coupling.joint for coupling in couplings(model))]
    return np.concatenate([model.jnt_qposadr[posture], *carried]).astype(np.int32)


def posture_joints(model: mujoco.MjModel, loose: Iterable[str] = ()) -> np.ndarray:
    """Return the ids of the body's own joints: hinges and slides with a range that follow no other joint.

    Args:
        model: The model.
        loose: Names of bodies whose joints are none of them.
    """
    free = np.isin(model.jnt_type, POINT_JOINTS) & (model.jnt_range[:, 0] < model.jnt_range[:, 1])
    free[[coupling.joint for coupling in couplings(model)]] = False
    free[np.isin(model.jnt_bodyid, [model.body(name).id for name in loose])] = False
    return np.flatnonzero(free)


@with_build_lock
def find_starts(spec: TaskSpec, progress: bool = True) -> Starts:
    """Return random starts of a task, from disk if they were found before.

    They are tried in a simulation of their own on the CPU, so that they are the same for every device.

    Args:
        spec: The task.
        progress: Whether to show a progress bar once this takes longer than a moment.

    Returns:
        1024 starts.

    Raises:
        ValueError: Too few starts are good ones, or a body cannot be carried.
    """
    model = oracle_model(spec)
    values = cached(
        ("random_starts", NUM_STARTS, model_digest(model), *_identity(spec)),
        make=lambda: _find(spec, progress),
        save=array_bytes,
        load=array_from_bytes,
    )
    return Starts(values, start_address(spec, model))


def _identity(spec: TaskSpec) -> tuple[object, ...]:
    """Return what decides besides the model whether a start is a good one: values, and code."""
    values = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec)}
    called = [value for value in values.values() if callable(value)]
    values |= {name: getattr(v, "__qualname__", repr(v)) for name, v in values.items() if callable(v)}
    kinds = (value if hasattr(value, "__qualname__") else type(value) for value in called)
    code = code_digest(type(spec), spec.program, *kinds)
    return values, code, source_digest(more=(Path(__file__), Path(palm.__file__)))


def _find(spec: TaskSpec, progress: bool) -> np.ndarray:
    """Search until there are enough."""
    found: list[np.ndarray] = []
    with quiet():
        shard = Shard(compile_scene(spec, BATCH, device="cpu", reset="fixed"), progress=progress)
    with (
        quiet(),
        wp.ScopedDevice("cpu"),
        patient_bar(
            "Finding random starts", "starts", NUM_STARTS, patience=PATIENCE, show=progress
        ) as advance,
    ):
        for survivors in Search(spec, shard).survivors():
            found += survivors
            advance(len(survivors))
            if len(found) >= NUM_STARTS:
                return np.stack(found[:NUM_STARTS])
    raise ValueError(
        f"task {spec.key!r} has too few random starts: {len(found)} of {NUM_STARTS} after {MAX_DRAWS} draws; "
        "use reset='fixed'"
    )


class Search:
    """Draws starts and puts them on trial.

    Attributes:
        draws: Postures drawn so far.
        num_steps: Control steps of a trial.
    """

    def __init__(self, spec: TaskSpec, shard: Shard) -> None:
        """Note what the task's own start is like; `shard` is used up."""
        self.shard, self.draws, self.rng = shard, 0, np.random.default_rng(0)
        self.model = copy.copy(shard.scene.oracle)
        self.data = mujoco.MjData(self.model)
        self.start = spec.start(self.model)
        joints = posture_joints(self.model, spec.loose)
        self.posture, self.address = self.model.jnt_qposadr[joints], start_address(spec, self.model)
        self.low, self.high = self.model.jnt_range[joints].T
        loose = [palm.joint_address(self.model, self.model.body(name).id) for name in spec.loose]
        self.loose = np.concatenate(loose, dtype=int) if loose else np.zeros(0, dtype=int)
        self.palm = palm.Palm(shard.scene.oracle, self.start, BODIES[spec.body].palm, spec.carried)
        hold_steps = int(np.ceil(HOLD_TIME / spec.control_dt)) if spec.carried else 0
        self.num_steps = max(FAIL_STEPS, hold_steps)
        self.terms = wp.zeros_like(shard.transition.terms)
        self.solved, self.failed = wp.zeros(BATCH, dtype=bool), wp.zeros(BATCH, dtype=bool)
        self.everywhere = wp.ones(BATCH, dtype=bool)
        self.scenes = self._draw_scenes()
        self.waiting: list[np.ndarray] = []

    def survivors(self) -> Iterator[list[np.ndarray]]:
        """Yield, after every control step, the starts whose trial ended well; until too many were drawn.

        A world whose trial has ended takes the next start.
        """
        rows = np.zeros((BATCH, len(self.address)))
        age, free = np.zeros(BATCH, dtype=np.int32), np.ones(BATCH, dtype=bool)
        while self._enough_waiting(int(free.sum())):
            if free.any():
                rows[free] = [self.waiting.pop() for _ in range(free.sum())]
                self.shard.reset(free, self.rng.integers(2**32, size=BATCH))
                self._write(free, rows[free])
                age[free] = 0
            self.shard.step()
            age += 1
            lost = self.lost(age)
            passed = ~lost & (age == self.num_steps)
            yield list(rows[passed])
            free = lost | passed

    def _write(self, mask: np.ndarray, rows: np.ndarray) -> None:
        """Put starts into the worlds of a mask."""
        qpos = self.shard.scene.data.qpos.numpy().copy()
        qpos[np.ix_(mask, self.address)] = rows
        self.shard.scene.data.qpos.assign(qpos)

    def _enough_waiting(self, count: int) -> bool:
        """Draw until so many starts wait for their trial; whether there are as many."""
        while len(self.waiting) < count and self.draws < MAX_DRAWS:
            drawn: list[np.ndarray] = []
            while len(drawn) < BATCH and self.draws < MAX_DRAWS:
                drawn += self._draw()
            if drawn:
                self.waiting += self._not_failed(np.stack(drawn))
        return len(self.waiting) >= count

    def _draw(self) -> list[np.ndarray]:
        """Draw a posture; return its start, or nothing if it is not free of penetration.

        Where geoms touch, the share of the joints that move, and how far each of them goes, are square
        roots of uniform numbers: 2/3 on average. Closer to 1 postures would differ more, and fewer be good.
        """
        self.draws += 1
        draw, number = self.rng.uniform, len(self.posture)
        step = np.ones(number)
        if self.shard.scene.capacity.peak_contacts > 0:
            step = np.where(draw(size=number) < np.sqrt(draw()), np.sqrt(draw(size=number)), 0.0)
        qpos = self.start.copy()
        qpos[self.posture] += step * (draw(self.low, self.high) - qpos[self.posture])
        follow(self.model, qpos)
        self.palm.place(qpos)
        values = qpos[self.address]
        for fields, drawn_qpos, allowed in self.scenes:
            tested = drawn_qpos.copy()
            tested[self.address] = values
            if (self._depth(fields, tested) > allowed).any():
                return []
        return [values]

    def _draw_scenes(self) -> list[tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]]:
        """Return fields of the model, configuration and allowed depths at the starts of several episodes.

        The first is the task's own start; those that agree are returned once.
        """
        scene = self.shard.scene
        self.shard.reset(seeds=self.rng.integers(2**32, size=BATCH))
        qpos = np.vstack([np.float32(self.start), scene.data.qpos.numpy()[:NUM_EPISODES]]).astype(float)
        fields = {}
        for name in (*SIZES, *PLACES):
            if name in scene.spec.batched:
                values = getattr(scene.model, name).numpy().reshape(BATCH, -1).copy()
                if name in SIZES:
                    values[:] = values.max(axis=0)
                own = getattr(self.model, name).reshape(1, -1)
                fields[name] = np.concatenate([np.float32(own), values[:NUM_EPISODES]])
        rows = np.concatenate([qpos, *fields.values()], axis=1)
        scenes = []
        for row in np.unique(rows, axis=0, return_index=True)[1]:
            here = {
                name: field[row].reshape(getattr(self.model, name).shape) for name, field in fields.items()
            }
            scenes.append((here, qpos[row], self._depth(here, qpos[row]) + PENETRATION))
        return scenes

    def _depth(self, fields: dict[str, np.ndarray], qpos: np.ndarray) -> np.ndarray:
        """Return how deep each pair of geoms penetrates [m], shape (ngeom, ngeom)."""
        for name, values in fields.items():
            getattr(self.model, name)[:] = values
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        depth = np.zeros((self.model.ngeom, self.model.ngeom))
        contact = self.data.contact
        np.maximum.at(depth, tuple(contact.geom.T), -contact.dist)
        return depth

    def _not_failed(self, rows: np.ndarray) -> list[np.ndarray]:
        """Return those of at most `BATCH` starts that do not fail where they stand."""
        qpos = self.shard.scene.data.qpos
        present = qpos.numpy().copy()
        self._write(np.arange(BATCH) < len(rows), rows)
        failed = self.fails(np.full(BATCH, FAIL_STEPS, dtype=np.int32))
        qpos.assign(present)
        return list(rows[~failed[: len(rows)]])

    def lost(self, age: np.ndarray) -> np.ndarray:
        """Whether the starts on trial, so many steps old, have failed or let an object go; shape (BATCH,)."""
        data = self.shard.scene.data
        lost = self.fails(age) | (self.shard.transition.fault.numpy() != 0)
        return lost | (self.palm.drift(data.xpos.numpy(), data.xmat.numpy()) > HOLD_DISTANCE)

    def fails(self, age: np.ndarray) -> np.ndarray:
        """Whether the task fails in the present configurations in any of several episodes; shape (BATCH,)."""
        scene, program = self.shard.scene, self.shard.program
        episode, qpos = scene.keys.episode.numpy().copy(), scene.data.qpos.numpy().copy()
        step_count = wp.array(age, dtype=int)
        failed = np.zeros(BATCH, dtype=bool)
        for later in reversed(range(NUM_EPISODES)):  # the last is the present episode, drawn once more
            scene.keys.episode.assign(episode + later)
            program.sample_start(self.everywhere)
            program.sample_goal(self.everywhere)
            tested = qpos.copy()
            tested[:, self.loose] = scene.data.qpos.numpy()[:, self.loose]
            scene.data.qpos.assign(tested)
            with engine_kernels_alone():
                mjw.kinematics(scene.model, scene.data)
            program.advance(step_count)
            program.score(step_count, self.terms, self.solved, self.failed)
            failed |= self.failed.numpy()
        scene.data.qpos.assign(qpos)
        return failed
