"""Task families; importing this package registers every id. A new family is one file and one import."""

from myowarp.tasks import baoding, key_turn, object_hold, pen_twirl, pose, reach  # noqa: F401  (they register)
