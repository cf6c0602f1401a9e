"""Laws of muscles: curves of four published models, activation, and Hill's equation."""
