"""Task families; importing this package registers every id. A new family is one file and one import."""

from myowarp.tasks import (  # noqa: F401  (they register)
    baoding,
    key_turn,
    object_hold,
    pen_twirl,
    pose,
    pose_hand,
    reach,
)
