"""An OpenSim document, read."""
