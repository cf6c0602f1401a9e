"""Reports: figures, descriptions of tasks."""
