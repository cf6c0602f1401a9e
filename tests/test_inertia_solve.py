"""The sparse factorisation of inertia matrices, against NumPy in float64."""

from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from mujoco_warp._src import smooth

from myowarp.fusions import FUSIONS

NUM_WORLDS = 16
ROUNDING = 2e-6  # of the largest acceleration; condition numbers below 200
LEAF = '<body pos="0 0 0.1"><joint axis="1 0 0"/><joint axis="0 1 0"/><geom size="0.05"/>{inside}</body>'
TREE = LEAF.format(inside=LEAF.format(inside=LEAF.format(inside="") * 2) + LEAF.format(inside=""))
MODELS = {
    "tree": f"<mujoco><worldbody>{TREE}</worldbody></mujoco>",
    "two trees": f"<mujoco><worldbody>{TREE}<body pos='1 0 0'><freejoint/><geom size='0.1 0.2 0.3' "
    "type='ellipsoid'/></body></worldbody></mujoco>",
}


def dense(model, rows):
    """Return the symmetric matrix of MuJoCo's sparse rows."""
    matrix = np.zeros((model.nv, model.nv))
    for dof in range(model.nv):
        first = model.M_rowadr[dof]
        for entry in range(first, first + model.M_rownnz[dof]):
            other = model.M_colind[entry]
            matrix[dof, other] = matrix[other, dof] = rows[entry]
    return matrix


@pytest.mark.parametrize("name", MODELS)
def test_solution_is_that_of_the_dense_system(name):
    host = mujoco.MjModel.from_xml_string(MODELS[name])
    with wp.ScopedDevice("cpu"):
        model = mjw.put_model(host)
        data = mjw.make_data(host, nworld=NUM_WORLDS)
        rng = np.random.default_rng(0)
        data.qpos.assign(data.qpos.numpy() + rng.normal(size=(NUM_WORLDS, host.nq)))
        mjw.fwd_position(model, data)
        scene = SimpleNamespace(model=model, data=data, device=wp.get_device("cpu"))
        y = rng.normal(size=(NUM_WORLDS, host.nv)).astype(np.float32)
        x = wp.zeros((NUM_WORLDS, host.nv), dtype=float)
        x.fill_(np.nan)
        with FUSIONS["inertia_solve"](scene).installed():
            smooth.factor_solve_i(model, data, data.M, None, None, x, wp.array(y, dtype=float))
    rows = data.M.numpy().astype(float)
    expected = np.array(
        [np.linalg.solve(dense(host, M), b) for M, b in zip(rows, y.astype(float), strict=True)]
    )
    assert np.abs(expected).max() > 10
    assert np.abs(x.numpy() - expected).max() <= ROUNDING * np.abs(expected).max()
