"""An OpenSim model: elements, functions, coordinates, equations of motion."""
