"""From recorded markers to a figure of muscle forces: motion_figure.py MODEL.osim WALK.trc FOLDER."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from myowarp import motion

model, markers, out = map(Path, sys.argv[1:])
person = motion.Bones.read(model)
trial = motion.TrialSetup(markers=markers, motion=out / "ik.mot", cutoff=6.0, reserve=100.0)
motion.kinematics(person, trial).write(out)
found = motion.forces(person, trial)
plt.plot(found.motion.time, found.solved.force, label=found.solved.muscles)
plt.xlabel("time [s]")
plt.ylabel("force [N]")
plt.legend()
plt.savefig(out / "forces.png")
