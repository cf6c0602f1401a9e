"""What torn tendons transmit, in exact fractions of decimal times."""

from fractions import Fraction


def transmission(step: int, control_dt: float, time: float, left: float) -> float:
    """Factor on a muscle's force in the control step that begins after `step` others."""
    begin = step * Fraction(str(control_dt))
    return left if begin >= Fraction(str(time)) else 1.0
