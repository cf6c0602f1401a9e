"""Task families; importing this package registers every id. A new family is one file and one import."""

from myowarp.tasks import (  # noqa: F401  (they register)
    baoding_ids,
    die_reorient_ids,
    directional,
    ground,
    human_walk,
    key_turn,
    object_hold,
    pen_twirl,
    pose_ids,
    reach_ids,
    relocate_ids,
    reorient_ids,
    stand,
    terrain,
    walk,
)
