"""The built model against OpenSim's."""
