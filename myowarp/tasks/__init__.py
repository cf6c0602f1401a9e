"""Task families; importing this package registers every id. A new family is one file and one import."""

from myowarp.tasks import pose, reach  # noqa: F401  (they register their tasks)
