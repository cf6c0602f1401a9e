"""Ligaments and springs along a path, which pull while it is longer than at rest.

    T = f(l / l_0) (1 + d dl/dt) + c max(dl/dt, 0) S((l / l_0 - 1) / 0.01) for l > l_0, else 0

f is a spline (Ligament; d = c = 0), a parabola over the toe and a line (Blankevoort1991Ligament; d = 0) or a
line (PathSpring; c = 0), and S the step of coordinate_limit.py.

Forces between two points and of formulas (PointToPointSpring, ExpressionBased...) have any T of l and dl/dt.

Sources: OpenSim 4.6, classes of these names; Blankevoort, Huiskes 1991, doi:10.1115/1.2894883.
"""

import warp as wp

from myowarp.laws.expressions import Programs, Variables, run
from myowarp.laws.forces.coordinate_limit import onset

SETS_IN = wp.constant(wp.float64(0.01))
"""Strain over which the damping of a ligament sets in."""


@wp.struct
class Ligament:
    """A tendon that pulls by itself.

    Attributes:
        tendon: Its id, or number.
        resting_length: l_0 [m].
        dissipation: d [s/m].
        damping: c [N s/m].
        program: Formula of l and dl/dt that is T; -1: there is none.
    """

    tendon: int
    resting_length: wp.float64
    dissipation: wp.float64
    damping: wp.float64
    program: int


@wp.func
def ligament_tension(
    ligament: Ligament, formulas: Programs, spring: wp.float64, length: wp.float64, velocity: wp.float64
) -> wp.float64:
    """T [N]; `spring` is f(l / l_0)."""
    if ligament.program >= 0:
        at = Variables()
        at[0] = length
        at[1] = velocity
        return run(formulas, ligament.program, at)
    strain = length / ligament.resting_length - wp.float64(1.0)
    if strain <= wp.float64(0.0):
        return wp.float64(0.0)
    lengthening = wp.max(velocity, wp.float64(0.0)) * onset(strain / SETS_IN)
    return spring * (wp.float64(1.0) + ligament.dissipation * velocity) + ligament.damping * lengthening
