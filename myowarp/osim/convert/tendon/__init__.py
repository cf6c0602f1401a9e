"""Paths as MuJoCo has them, and how they come near OpenSim's."""
