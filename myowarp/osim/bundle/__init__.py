"""What a scene takes of a model of OpenSim beside its MJCF: couplings, paths, forces, coordinates."""
