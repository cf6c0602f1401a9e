"""A page in the browser that shows worlds as they move; viser draws, nothing of it is needed elsewhere."""
