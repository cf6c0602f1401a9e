"""The physics step, and everything that touches private names of Warp or of mujoco-warp."""
