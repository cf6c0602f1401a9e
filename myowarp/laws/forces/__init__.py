"""Forces of OpenSim other than those of muscles and motors."""
