"""A body with a free root: a pose and a reach task."""

from pathlib import Path

import mujoco

import myowarp


def hopper():
    return mujoco.MjSpec.from_file(str(Path(__file__).with_name("free_root.xml")))


myowarp.BODIES.add("outside_hopper", myowarp.Body(hopper, tips=("foot",)))


@myowarp.task("outsideHopperPose-v0")
def pose():
    """Bring hip and knee to fixed angles."""
    angles = (0.7, -1.1)
    return myowarp.PoseTask(
        body="outside_hopper", target_low=angles, target_high=angles, near=0.2, horizon=20, physics_dt=0.002
    )


@myowarp.task("outsideHopperReach-v0")
def reach():
    """Bring the foot to a fixed point."""
    still = (0.0, 0.0, 0.0)
    return myowarp.ReachTask(
        body="outside_hopper", center=(0.3, 0.0, 1.4), low=still, high=still, far_per_tip=9.0, horizon=20
    )
