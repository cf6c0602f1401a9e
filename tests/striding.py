"""Walks whose measures are known in closed form."""

import numpy as np

from myowarp.motion.strides import GRAVITY, Walk

RATE = 1e-3  # s
MASS = 70.0
A, B = 1.1, 0.4
"""Force over a stance, u from 0 to 1, in body weights: A sin(pi u) + B sin(3 pi u)."""
PEAK = 2.0 / 3.0 * (A + 3.0 * B) * np.sqrt((A + 3.0 * B) / (12.0 * B))
VALLEY = A - B
HEADING = 0.6  # rad, from x to y


def striding(
    *,
    speed=1.3,
    period=1.1,
    width=0.12,
    reach=0.25,
    height=0.95,
    stance=0.6,
    late=0.0,
    swing=20.0,
    lift=0.0,
    rate=4.0,
    shift=0.0,
    mass=MASS,
    seconds=6.0,
    **more,
):
    """Return a walk ahead at HEADING.

    Args:
        speed: Of the mass centre [m/s].
        period: Of a stride [s].
        width: Of a step [m].
        reach: Of a foot ahead of the mass centre when it comes down [m].
        height: Of the mass centre [m].
        stance: Share of the stride.
        late: Of the left foot, as a share of the stride.
        swing: Amplitude of the knees [degrees].
        lift: Added to the knees' angles [degrees].
        rate: Metabolic rate [W/kg].
        shift: Of muscles and knees in the cycle, as a share of it.
        mass: [kg].
        seconds: Of the walk.
        more: What else `Walk` takes.
    """
    time = np.arange(0.0, seconds, RATE)
    ahead, left = np.array((np.cos(HEADING), np.sin(HEADING))), np.array((-np.sin(HEADING), np.cos(HEADING)))
    center = np.column_stack([np.outer(speed * time, ahead), np.full(len(time), height)])
    curves, foot, force = {}, {}, {}
    for side, begin, out in (("r", 0.3, -1.0), ("l", 0.3 + (0.5 + late) * period, 1.0)):
        cycle = (time - begin) / period
        number, phase = np.floor(cycle), cycle % 1.0
        down = speed * (begin + number * period) + reach
        swung = np.clip((phase - stance) / (1.0 - stance), 0.0, 1.0)
        foot[side] = np.outer(down + swung * speed * period, ahead) + out * 0.5 * width * left
        u = np.minimum(phase / stance, 1.0)
        force[side] = mass * GRAVITY * np.maximum(A * np.sin(np.pi * u) + B * np.sin(3.0 * np.pi * u), 0.0)
        turn = 2.0 * np.pi * (phase - shift)
        curves[f"knee_angle_{side}"] = lift + swing * np.sin(turn)
        curves[f"knee_moment_{side}"] = 0.5 * np.cos(turn)
        curves[f"soleus_{side}"] = np.where((phase - shift) % 1.0 < 0.4, 0.8, 0.05)
    return Walk(
        mass, time, center, foot, curves, time, force, metabolic_rate=np.full(len(time), rate), **more
    )
