"""Pictures, videos and live views of worlds; nothing here takes part in a simulation."""
