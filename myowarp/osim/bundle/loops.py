"""Loops that equalities of MuJoCo close between bodies, and poses in which they are closed."""

import copy

import mujoco
import numpy as np

from myowarp.osim.bundle.couplings import Couplings, couplings, follow, jacobian
from myowarp.process import warn_once

CONNECT, WELD = mujoco.mjtEq.mjEQ_CONNECT.value, mujoco.mjtEq.mjEQ_WELD.value
HARD = 0.9999
"""Impedance of equalities that are to hold exactly: the greatest that MuJoCo has."""
ROUNDS = 50
CLOSED, SAME = 1e-10, 1e-6
"""Gap [m or rad] of a loop that is closed; and of singular values, relative, that are no motion."""


def loops_of(model: mujoco.MjModel) -> np.ndarray:
    """Return the equalities of a model that close loops and are to hold exactly."""
    kinds = np.isin(model.eq_type, (CONNECT, WELD)) & model.eq_active0.astype(bool)
    return np.flatnonzero(kinds & (model.eq_solimp[:, 0] >= HARD))


def loop_rows(model: mujoco.MjModel) -> int:
    """Return how many rows they have; 0 where a model has softer equalities of bodies beside them."""
    loops = loops_of(model)
    alone = len(loops) == np.isin(model.eq_type, (CONNECT, WELD)).sum()
    return 3 * (len(loops) + int((model.eq_type[loops] == WELD).sum())) if alone else 0


def settled(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Return a copy of a configuration (nq,) in which joints that follow exactly do, and loops are closed.

    Newton's steps along the free coordinates, each the least that closes the loops to first order. A line is
    logged where they stay open.
    """
    qpos = qpos.copy()
    if Couplings.of(model) is None:
        return qpos
    follow(model, qpos)
    if not len(loops_of(model)):
        return qpos
    host, ties = copy.copy(model), couplings(model)
    host.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    host.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    data, gap = mujoco.MjData(host), np.full(1, np.inf)
    for _ in range(ROUNDS):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(host, data)
        rows = np.isin(data.efc_id[: data.ne], loops_of(host))
        gap = data.efc_pos[: data.ne][rows]
        if not np.isfinite(gap).all() or np.abs(gap).max() < CLOSED:
            break
        free, slopes, _ = jacobian(host, ties, qpos)
        turned = data.efc_J.reshape(-1, host.nv)[: data.ne][rows] @ slopes
        step = np.zeros(host.nv)
        step[free] = -np.linalg.pinv(turned, rcond=SAME) @ gap
        mujoco.mj_integratePos(host, qpos, step, 1.0)
        follow(host, qpos)
    if not np.abs(gap).max() < 1e3 * CLOSED:
        warn_once(
            f"loops of the start pose stay open by {np.abs(gap).max():.2g} m; no pose near it closes them"
        )
    return qpos
