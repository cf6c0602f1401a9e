"""Models of OpenSim: read, put on a device, taken by scenes, converted to MuJoCo."""
