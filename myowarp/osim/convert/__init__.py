"""From .osim to MJCF: composed, fitted to plain MuJoCo, checked and reported."""
