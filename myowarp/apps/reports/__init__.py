"""What a result looks like: figures, descriptions of tasks."""
