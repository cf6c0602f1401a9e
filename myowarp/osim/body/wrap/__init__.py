"""Paths as OpenSim has them: the reference."""
