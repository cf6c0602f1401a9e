"""A converted arm as a reach task: bring the marker at its wrist to points drawn anew each episode.

First: myowarp convert arm26.osim -o out/arm26
"""

import sys

import myowarp

path = sys.argv[1] if len(sys.argv) > 1 else "out/arm26/model.xml"
task = myowarp.from_mjcf(path, "arm26ReachRandom-v0", "reach", targets="r_radius_styloid")

env = myowarp.make_vec(task, 64, device="cpu")
observations, _ = env.reset(seed=0)
for _ in range(task.horizon):
    observations, reward, *_ = env.step(env.action_space.sample())
print(f"{env.num_envs} arms, observations {observations.shape}, mean reward {reward.mean():.3f}")
