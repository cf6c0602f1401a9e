"""Paths of all tendons, and what actuators make of them, in one launch instead of six."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src import smooth

from myowarp.engine.idle import pruned
from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.path_program import MusclePaths, path_obstacle
from myowarp.spec.scene import Scene


@FUSIONS.register("muscle_path")
class MusclePathFusion(Fusion):
    """`kernels.muscle_path` in place of tendons, transmissions, actuator velocities and positions of sites.

    It writes all that they write and later launches read, in the engine's layout, so muscles, limits of
    tendons, motors and conditions see no difference. Only the sites are left as they were: nothing reads them
    within a physics step, and tasks and probes bring them up to date themselves.
    """

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """See `Fusion`; what MuJoCo calls armature moves with a tendon and needs its path's derivative."""
        host = scene.oracle
        if host.nsensor:
            return "sensors, which may read sites within a step"
        if np.any(host.eq_objtype == mujoco.mjtObj.mjOBJ_SITE):
            return "an equality between sites"
        if np.any(host.tendon_armature) or np.any(host.actuator_armature):
            return "armature of a tendon or an actuator"
        return path_obstacle(host)

    def __init__(self, scene: Scene) -> None:
        with wp.ScopedDevice(scene.device):
            self._paths = MusclePaths(scene.oracle, scene.model, scene.data)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """See `Fusion`."""
        with (
            mock.patch.object(smooth, "tendon", self._launch),
            mock.patch.object(smooth, "transmission"),
            pruned(frozenset({"_actuator_velocity", "_site_local_to_global"})),
        ):
            yield

    def _launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Do what stands for the engine's `tendon`, and for its `transmission` too."""
        self._paths.launch()
