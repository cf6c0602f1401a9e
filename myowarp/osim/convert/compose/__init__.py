"""MuJoCo's model of an OpenSim model."""
