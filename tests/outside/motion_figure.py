"""From recorded markers to a figure of muscle forces: motion_figure.py MODEL.osim WALK.trc FOLDER."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from myowarp import motion

model, markers, out = map(Path, sys.argv[1:])
person = motion.Bones.read(model)
motion.kinematics(person, markers, out)
walk = motion.read_motion(out / "ik.mot", person, cutoff=6.0)
found = motion.forces(person, walk, out, reserves=dict.fromkeys(person.coordinates, 100.0))
plt.plot(walk.time, found.force, label=found.muscles)
plt.xlabel("time [s]")
plt.ylabel("force [N]")
plt.legend()
plt.savefig(out / "forces.png")
