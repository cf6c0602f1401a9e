"""Bodies of any number of degrees of freedom: a floating trunk, limbs, a pair of muscles about each hinge."""

from pathlib import Path

import numpy as np

ROOT, LIMB = 6, 7  # degrees of freedom of the trunk, and of a limb at most
SEGMENT = 0.08  # m
MUSCLE = 'class="muscle" lengthrange=".02 .3" ctrlrange="0 1" force="20"'


def large_body(num_dofs: int) -> str:
    """Return the MJCF of a body with a free root that falls on the ground.

    Args:
        num_dofs: Degrees of freedom, those of the root included; more than 6.
    """
    sizes = [
        len(hinges) for hinges in np.array_split(np.arange(num_dofs - ROOT), -(-(num_dofs - ROOT) // LIMB))
    ]
    limbs, tendons, muscles = [], [], []
    for number, size in enumerate(sizes):
        angle = 2 * np.pi * number / len(sizes)
        limb = '<geom type="sphere" size=".03" condim="3" contype="1"/>'
        for joint in reversed(range(size)):
            name = f"{number}_{joint}"
            axis = ("1 0 0", "0 1 0", "0 0 1")[joint % 3]
            limb = (
                f'<joint name="{name}" axis="{axis}"/><geom type="capsule" size=".02" '
                f'fromto="0 0 0 {SEGMENT} 0 0"/><site name="{name}_a" pos=".04 .03 .03"/>'
                f'<site name="{name}_b" pos=".04 -.03 -.03"/><body pos="{SEGMENT} 0 0">{limb}</body>'
            )
            for side in "ab":
                before = f"{number}_{joint - 1}_{side}" if joint else f"{number}_{side}"
                muscle = f"{name}_{side}"
                path = f'<site site="{before}"/><site site="{muscle}"/>'
                tendons.append(f'<spatial name="{muscle}">{path}</spatial>')
                muscles.append(f'<muscle name="{muscle}" tendon="{muscle}" {MUSCLE}/>')
        at = f"{0.1 * np.cos(angle):.4f} {0.1 * np.sin(angle):.4f}"
        limbs.append(
            f'<site name="{number}_a" pos="{at} .03"/><site name="{number}_b" pos="{at} -.03"/>'
            f'<body pos="{at} 0" euler="0 0 {np.degrees(angle):.4f}">{limb}</body>'
        )
    return f"""
<mujoco model="large body {num_dofs}">
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0" density="1000"/>
    <joint range="-60 60" damping=".05" armature=".002"/><default class="muscle"/></default>
  <worldbody>
    <geom type="plane" size="5 5 .1" conaffinity="1"/>
    <body name="trunk" pos="0 0 .2"><freejoint/><geom type="ellipsoid" size=".1 .1 .05"/>
      {"".join(limbs)}
    </body>
  </worldbody>
  <tendon>{"".join(tendons)}</tendon>
  <actuator>{"".join(muscles)}</actuator>
</mujoco>
"""


def write_large_body(folder: Path, num_dofs: int) -> Path:
    """Write the MJCF of a body into a folder; returns its path."""
    path = folder / f"large_body_{num_dofs}.xml"
    path.write_text(large_body(num_dofs))
    return path
