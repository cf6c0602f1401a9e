"""Muscle laws of OpenSim, and MuJoCo's muscle fitted to them."""
