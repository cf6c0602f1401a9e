"""What an OpenSim model is: elements, functions, coordinates, equations of motion."""
