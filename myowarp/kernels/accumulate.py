"""Sums of very many small terms in float32."""

import warp as wp


@wp.func
def add_compensated(total: float, rounding: float, term: float) -> wp.vec2:
    """Return total + term and what the sum rounded away, to be passed in with the next term.

    A plain float32 sum near 1 loses terms below 6e-8; this one loses nothing that adds up. Source: Kahan
    (1965), doi:10.1145/363707.363723.
    """
    corrected = term - rounding
    enlarged = total + corrected
    return wp.vec2(enlarged, (enlarged - total) - corrected)
