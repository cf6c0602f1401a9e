"""Terms of the reward, and endings, that several task families share: functions of one world."""

import warp as wp


@wp.func
def indicator(condition: bool) -> float:
    """1 if the condition holds, else 0."""
    return wp.where(condition, 1.0, 0.0)


@wp.func
def minus_effort(activation: wp.array[float]) -> float:
    """Minus the norm of the activations divided by their number, MyoSuite's `act_mag`; 0 without muscles."""
    total = float(0.0)
    for i in range(activation.shape[0]):
        total += activation[i] * activation[i]
    return -(wp.sqrt(total) / wp.max(float(activation.shape[0]), 1.0))


@wp.func
def minus_bhargava2004(bhargava2004: wp.array[float]) -> float:
    """Minus the metabolic rate of all muscles after Bhargava 2004 [W]."""
    total = float(0.0)
    for i in range(bhargava2004.shape[0]):
        total += bhargava2004[i]
    return -total


@wp.func
def minus_umberger2010(umberger2010: wp.array[float]) -> float:
    """Minus the metabolic rate of all muscles after Umberger 2010 [W]."""
    total = float(0.0)
    for i in range(umberger2010.shape[0]):
        total += umberger2010[i]
    return -total


EFFORT = ("1", "minus the effort: Euclidean norm of the activations over their number", minus_effort)
"""The end of a `definitions.task.RewardTerm`: unit, meaning, source."""


@wp.func
def minus_error(error: float) -> float:
    """-error."""
    return -error


@wp.func
def near_bonus(error: float, near: float, wider: float) -> float:
    """1[error < near] + 1[error < wider near]."""
    return indicator(error < near) + indicator(error < wider * near)


@wp.func
def is_near(error: float, near: float) -> bool:
    """Error < near."""
    return error < near


@wp.func
def is_far(error: float, far: float) -> bool:
    """Error > far."""
    return error > far


@wp.func
def minus_failed(failed: bool) -> float:
    """-1[failed]."""
    return -indicator(failed)
