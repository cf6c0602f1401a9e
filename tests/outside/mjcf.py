"""Tasks on an MJCF of one's own."""

from pathlib import Path

import myowarp

FILE = Path(__file__).with_name("free_root.xml")

pose = myowarp.from_mjcf(FILE, "outsideMjcfPoseRandom-v0", horizon=20)
knee = myowarp.from_mjcf(
    FILE, "outsideMjcfKnee-v0", targets={"knee": (-0.3, -0.1)}, near=0.05, control_dt=0.01
)
reach = myowarp.from_mjcf(
    FILE, "outsideMjcfReachRandom-v0", "reach", targets="foot", rewards={"act_reg": 1.0}
)
