"""Torso in MyoSuite's exosuit, which is passive: two elastic straps cross the back.

Source: MyoSuite 3.0.0; meshes from myo-sim 0.2.3. The suit has parts at thighs, belt and shoulders. That at
the thighs is fixed; soft welds hold the other two, each with six coordinates of its own, to the fourth lumbar
vertebra and to the thorax. The straps run from shoulder to opposite thigh over a cylinder on the back; slack
up to 0.37 m, then 516 N/m. Two more, from belt to thighs, are there to look at. As upstream, the harness has
the density of water and weighs 30 kg.
"""

from dataclasses import replace

import mujoco

from myowarp.definitions.body import BODIES
from myowarp.models.bodies.torso import FILES, TORSO, including, torso_in

AXES = 'quat="0.499949 0.500051 -0.500051 -0.499949" childclass="exosuit"'  # OpenSim's: y is up

PARTS = f"""
<body name="exo_pelvis" pos="0.005 0.13 0.979" {AXES}>
  <geom class="shell" name="lower_exo_legs_geom" mesh="thighs" pos="-0.08 0.1 0" euler="1.57 3.14 -1.57"/>
  <site name="Lower_Exo_Left_Leg" pos="-0.08 -0.15 -0.17"/>
  <site name="Lower_Exo_Right_Leg" pos="-0.08 -0.15 0.17"/>
  <site name="Exo_LeftLeg" pos="-0.2 0 -0.04"/>
  <site name="Exo_RightLeg" pos="-0.2 0 0.04"/>
</body>
<body name="exo_lumbar4" pos="-0.004 0.2001 1.05" {AXES}>
  <freejoint/>
  <geom class="shell" name="lower_exo_belt_geom" mesh="belt" mass="0.094" pos="0.03 0.03 0"
    euler="1.57 3.14 -1.57"/>
  <site name="Lower_Exo_Left_Belt" pos="0.02 0.02 -0.158"/>
  <site name="Lower_Exo_Right_Belt" pos="0.02 0.02 0.158"/>
</body>
<body name="exo_torso" pos="0.0045 0.216 1.06" {AXES}>
  <freejoint/>
  <geom class="shell" name="upper_exo_geom" mesh="harness" pos="0.01 0.165 0" euler="1.57 3.14 1.57"/>
  <geom class="myotorso_back_wrap" name="Exo_cylinder" size="0.105 0.13" pos="0.025 0.03 0" margin="0.001"/>
  <site name="Exo_LeftShoulder" pos="-0.11 0.28 -0.07"/>
  <site name="Exo_RightShoulder" pos="-0.11 0.28 0.07"/>
  <site name="Exo_sidesite" pos="-0.14 0.05 0"/>
</body>
"""

STRAP = """
<spatial class="exosuit" name="{name}" stiffness="515.5998876" springlength="0 0.37">
  <site site="{shoulder}"/> <geom geom="Exo_cylinder" sidesite="Exo_sidesite"/> <site site="{thigh}"/>
</spatial>
"""
BELT_STRAP = """
<spatial class="exosuit" name="Lower_Exo_{side}">
  <site site="Lower_Exo_{side}_Belt"/> <site site="Lower_Exo_{side}_Leg"/>
</spatial>
"""
STRAPS = (
    STRAP.format(name="Exo_LS_RL", shoulder="Exo_RightShoulder", thigh="Exo_LeftLeg")
    + STRAP.format(name="Exo_RS_LL", shoulder="Exo_LeftShoulder", thigh="Exo_RightLeg")
    + "".join(BELT_STRAP.format(side=side) for side in ("Left", "Right"))
)

SUIT = f"""
<default>
  <default class="exosuit">
    <site size="0.002" rgba="0 1 0 1"/>
    <tendon limited="false" width="0.006" group="1" rgba="0.38 0.33 0.33 1"/>
    <default class="shell">
      <geom type="mesh" margin="0.001" contype="0" conaffinity="0" rgba="0.35 0.3 0.3 1"/>
    </default>
  </default>
</default>
<asset>
  <mesh name="thighs" file="meshes/lower_exo_legs.stl" scale="0.0013 0.0013 0.0013"/>
  <mesh name="belt" file="meshes/lower_exo_belt.stl" scale="0.0015 0.0015 0.0013"/>
  <mesh name="harness" file="meshes/upper_exo.stl" scale="0.001 0.0011 0.001"/>
</asset>
<equality>
  <weld body1="torso" body2="exo_torso" anchor="-0.1 0.2 0"/>
  <weld body1="lumbar4" body2="exo_lumbar4"/>
</equality>
<tendon>{STRAPS}</tendon>
"""


def torso_exo() -> mujoco.MjSpec:
    """Return the torso in the suit; the coordinates of the suit's two loose parts, 14, come last."""
    return including(FILES, torso_in("full_body", "0.005 0.1 0.93") + PARTS, SUIT)


BODIES.add("torso_exo", replace(TORSO, build=torso_exo))
