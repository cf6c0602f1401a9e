"""A model of OpenSim on the device, in float64: bodies, paths, muscles and forces."""
