"""Bodies and muscle models, and how a body is made small."""
