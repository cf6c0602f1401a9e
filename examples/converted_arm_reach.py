"""A converted arm as a reach task: bring the marker at its wrist to points drawn anew each episode.

First: myowarp convert arm26.osim -o out/arm26
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.spec.task import TASKS
from myowarp.tasks.from_file import read_body
from myowarp.tasks.reach import ReachTask

TIP = "r_radius_styloid"
path = sys.argv[1] if len(sys.argv) > 1 else "out/arm26/model.xml"
model = mujoco.MjModel.from_xml_path(path)
data = mujoco.MjData(model)
data.qpos = model.jnt_range.mean(axis=1)
mujoco.mj_kinematics(model, data)
center, reach = data.site(TIP).xpos, np.array([0.1, 0.0, 0.1])

task = ReachTask(
    name="arm26Reach",
    body=read_body(Path(path), tips=(TIP,)),
    doc="Bring the wrist to a point.",
    center=tuple(center),
    low=tuple(-reach),
    high=tuple(reach),
    far_per_tip=1.0,
)
TASKS.add(task.key, task)

env = MyoWarpVectorEnv(task.key, 64, device="cpu")
observations, _ = env.reset(seed=0)
for _ in range(task.horizon):
    observations, reward, *_ = env.step(env.action_space.sample())
print(f"{env.num_envs} arms, observations {observations.shape}, mean reward {reward.mean():.3f}")
