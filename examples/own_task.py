"""Tasks of one's own: a variant, a reward term and an observation on top of it, and a task on one's own MJCF.

From Python: python examples/own_task.py
From the shell: myowarp rollout examples/own_task.py:thrifty --policy hold --num-worlds 64
"""

import dataclasses
import tempfile
from pathlib import Path

import gymnasium
import numpy as np
import warp as wp

import myowarp

MODEL = """<mujoco model="arm"><worldbody><site name="origin" pos=".05 0 .3"/>
  <body><joint name="elbow" axis="0 1 0" range="-60 60" damping=".1"/>
    <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" contype="0" conaffinity="0"/>
    <site name="insertion" pos=".03 0 -.2"/><site name="hand" pos="0 0 -.4"/></body></worldbody>
  <tendon><spatial name="flexor"><site site="origin"/><site site="insertion"/></spatial></tendon>
  <actuator><muscle name="flexor" tendon="flexor" force="200" lengthrange=".3 .6"/></actuator></mujoco>"""


@myowarp.task("myElbowPreciseRandom-v0")
def precise():
    """Bring the elbow to an angle within 0.05 rad."""
    return dataclasses.replace(myowarp.TASKS["myoElbowPose1D6MRandom-v0"], near=0.05)


@wp.func
def effort(excitation: wp.array[float]) -> float:
    """Sum of squared excitations."""
    total = float(0.0)
    for muscle in range(excitation.shape[0]):
        total += excitation[muscle] * excitation[muscle]
    return total


thrifty = myowarp.extend(
    "myElbowPreciseRandom-v0",
    "myElbowThriftyRandom-v0",
    rewards={"effort": (-0.1, effort), "bonus": 2.0},
    observations={"tension": "tension", "wrist": "site_xpos"},
    sites="wrist",
    doc="Bring the elbow to an angle with little excitation.",
)

path = Path(tempfile.mkdtemp()) / "arm.xml"
path.write_text(MODEL)
reach = myowarp.from_mjcf(path, "myArmReachRandom-v0", "reach", targets="hand", horizon=50)

if __name__ == "__main__":
    for task in (thrifty, reach):
        env = gymnasium.make_vec(task.env_id, num_envs=64, device="cpu")
        env.reset(seed=0)
        for _ in range(task.horizon):
            obs, reward, _, _, info = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        print(f"{task.env_id}: observations {obs.shape}, mean reward {reward.mean():.3f}")
        env.close()
