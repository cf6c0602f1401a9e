"""Bodies, muscle models and conditions, and points that a body's tips reach."""
