"""Parts of an OpenSim model that a scene takes beside its MJCF: couplings, paths, forces, coordinates."""
