"""Muscles in the present state of the worlds: their paths, their tension, and where an episode begins.

After a step lengths and velocities in `Data` are those of the last physics step's begin, and after a reset
those of another episode. The launches here recompute them, and write nothing else that lasts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.muscle import Anatomy
from myowarp.definitions.scene import Scene
from myowarp.engine.patch import engine_kernels_alone
from myowarp.kernels.batching import batched
from myowarp.kernels.launch import launch


@wp.kernel(enable_backward=False)
def read_paths(
    # Data in:
    actuator_length_in: wp.array2d[float],
    actuator_velocity_in: wp.array2d[float],
    # In:
    anatomy: Anatomy,
    mask: wp.array[bool],
    # Out:
    length: wp.array2d[float],
    velocity: wp.array2d[float],
):
    """Length and velocity of the path that each muscle pulls, in the worlds of the mask."""
    worldid, muscleid = wp.tid()
    if mask[worldid]:
        pathid = anatomy.path[batched(worldid, anatomy.path.shape[0]), muscleid]
        length[worldid, muscleid] = actuator_length_in[worldid, pathid]
        velocity[worldid, muscleid] = actuator_velocity_in[worldid, pathid]


def settle_muscles(scene: Scene, mask: wp.array, paths: Callable[[], None] | None = None) -> None:
    """Let muscles settle on their present paths in the worlds of `mask` (num_worlds,) bool.

    Args:
        scene: The compiled task.
        mask: The worlds.
        paths: Launches what brings paths there in these worlds; None: the engine's kernels.
    """
    muscles = scene.muscles
    (paths or partial(present_paths, scene))()
    launch(read_paths, muscles.length.shape, muscles, scene.data, mask=mask)
    muscles.settle(mask)


def present_paths(scene: Scene) -> None:
    """Bring lengths and velocities of the actuators to the present state."""
    model, data = scene.model, scene.data
    with engine_kernels_alone():
        mjw.kinematics(model, data)
        mjw.com_pos(model, data)
        (scene.paths.launch if scene.paths else mjw.tendon)(model, data)
        mjw.transmission(model, data)
        mjw.fwd_velocity(model, data)
    if scene.paths:
        scene.paths.launch_velocity(model, data)


def present_muscles(scene: Scene, paths: Callable[[], None] | None = None) -> Callable[[], None]:
    """Return launches that bring length, velocity and tension of the muscles to the present state.

    They write what the next physics step computes anew, and leave the state alone.

    Args:
        scene: The compiled task.
        paths: Launches what brings paths there; None: the engine's kernels.
    """
    model, data, state = scene.model, scene.data, scene.muscles.state
    # With a time step of 0 the muscles compute the force of the present state, which is then put back.
    no_time = wp.zeros(1, dtype=float, device=scene.device)
    still = dataclasses.replace(model, opt=dataclasses.replace(model.opt, timestep=no_time))
    before = {name: wp.zeros_like(array) for name, array in state.items()}

    def launch() -> None:
        if paths is None:
            present_paths(scene)
        else:
            paths()
        for name, array in state.items():
            wp.copy(before[name], array)
        scene.muscles.launch(still, data)
        for name, array in state.items():
            wp.copy(array, before[name])

    return launch


def tension_at(scene: Scene) -> Callable[[float], np.ndarray]:
    """Return a function from an activation of all muscles to their tension [N] on the present paths.

    Tensions are on the host, (num_worlds, num_muscles). Lengths of elastic tendons stay as they are.
    """
    present, activation = present_muscles(scene), scene.muscles.activation
    before = wp.zeros_like(activation)

    def tension(value: float) -> np.ndarray:
        wp.copy(before, activation)
        activation.fill_(value)
        present()
        wp.copy(activation, before)
        return scene.muscles.tension.numpy().copy()

    return tension
