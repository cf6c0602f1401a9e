"""MuJoCo's constraint forces in dense float64 NumPy, written from its documentation.

Source: MuJoCo documentation, Computation, "Primal problem" and "Constraint model", pyramidal cones: the
acceleration minimises 1/2 (x - a)' M (x - a) + sum_i s_i(J_i x - aref_i), M a = smooth. Rows come in the
order equalities, friction losses, limits and contacts.
"""

import numpy as np

MAX_ITERATIONS = 500
NOISE = 1e-13  # of the forces that cancel: float64 sums


def row_forces(residual, D, loss, ne, nf):
    """Return -s'(residual) of all rows: equalities pull, friction saturates, limits and contacts push."""
    force = -D * residual
    friction, push = slice(ne, ne + nf), slice(ne + nf, None)
    force[friction] = np.clip(force[friction], -loss[friction], loss[friction])
    force[push] = np.maximum(force[push], 0.0)
    return force


def row_costs(residual, D, loss, ne, nf):
    """Return s(residual) of all rows; that of friction is Huber's."""
    cost = D * residual**2 / 2
    knee = np.divide(loss, D, out=np.zeros_like(D), where=D > 0)
    friction, push = slice(ne, ne + nf), slice(ne + nf, None)
    outside = (np.abs(residual) > knee)[friction]
    huber = (loss * (np.abs(residual) - knee / 2))[friction]
    cost[friction] = np.where(outside, huber, cost[friction])
    cost[push] = np.where(residual[push] < 0, cost[push], 0.0)
    return cost


def imbalance(x, M, smooth, J, D, aref, loss, ne, nf):
    """Return the norm of M x - smooth - J' force as a share of the largest of the three."""
    terms = M @ x, smooth, J.T @ row_forces(J @ x - aref, D, loss, ne, nf)
    return np.linalg.norm(terms[0] - terms[1] - terms[2]) / max(np.linalg.norm(term) for term in terms)


def acceleration(M, smooth, J, D, aref, loss, ne, nf):
    """Return the acceleration by damped Newton steps from the one without constraints."""
    x = np.linalg.solve(M, smooth)
    origin = x.copy()

    def cost(x):
        away = x - origin
        return away @ M @ away / 2 + row_costs(J @ x - aref, D, loss, ne, nf).sum()

    for _ in range(MAX_ITERATIONS):
        if imbalance(x, M, smooth, J, D, aref, loss, ne, nf) < NOISE:
            break
        force = row_forces(J @ x - aref, D, loss, ne, nf)
        quadratic = np.isclose(force, -D * (J @ x - aref), rtol=1e-12, atol=0)
        hessian = M + J[quadratic].T @ (D[quadratic, None] * J[quadratic])
        step = -np.linalg.solve(hessian, M @ x - smooth - J.T @ force)
        share = 1.0
        while cost(x + share * step) > cost(x) and share > 1e-6:
            share /= 2
        x = x + share * step
    return x
