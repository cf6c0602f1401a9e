"""Bodies built from myo-sim; a new one is one file here and one import below."""

from myowarp.models.bodies import (
    arm,  # noqa: F401
    contact_hand,  # noqa: F401
    elbow,  # noqa: F401
    elbow_exo,  # noqa: F401
    finger,  # noqa: F401
    full_body,  # noqa: F401
    hand,  # noqa: F401
    legs,  # noqa: F401
    torso,  # noqa: F401
    torso_exo,  # noqa: F401
    whole_arm,  # noqa: F401
)
