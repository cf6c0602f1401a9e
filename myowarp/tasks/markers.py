"""Goal markers: sites that show where a tip should be. They are seen, and touch nothing."""

from collections.abc import Iterable

import mujoco

MARKER_RADIUS = 0.01  # m
MARKER_COLOR = (0.1, 0.7, 0.3, 0.9)


def add_tip_targets(spec: mujoco.MjSpec, tips: Iterable[str]) -> None:
    """Add a world site `<tip>_target` for every tip that has none, in place."""
    for tip in tips:
        name = f"{tip}_target"
        if spec.site(name) is None:
            site = spec.worldbody.add_site()
            site.name = name
        else:
            site = spec.site(name)
        site.size = (MARKER_RADIUS, MARKER_RADIUS, MARKER_RADIUS)
        site.rgba = MARKER_COLOR
