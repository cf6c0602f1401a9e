"""OpenSim models: reading, forward kinematics, and conversion to MuJoCo."""
