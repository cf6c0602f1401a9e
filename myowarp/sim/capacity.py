"""Numbers of contacts and constraint rows that a world can need, from the model and from random motion.

Arrays in mujoco-warp have fixed sizes; what does not fit is dropped, with wrong physics. So sizes are
measured with MuJoCo C, with a margin, and never guessed.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path

import mujoco
import numpy as np

from myowarp.definitions.scene import Capacity
from myowarp.disk import array_bytes, array_from_bytes, cached, files_digest, model_digest
from myowarp.engine import slim

MARGIN = 1.5  # over the largest numbers seen
NUM_EPISODES = 16
EPISODE_STEPS = 500
HOLD_STEPS = 10  # a control is held


def calibrate(model: mujoco.MjModel, start: np.ndarray, least_contacts: int = 0) -> Capacity:
    """Return sizes for a model, from disk if this model was measured before.

    Limits, friction loss and equalities have an exact bound. Contacts, and pairs of geoms whose bounding
    spheres overlap, are counted over random-control motion from the start; a model in which no pair of geoms
    can collide needs none.

    Args:
        model: The model.
        start: Configuration from which motion starts, shape (nq,).
        least_contacts: Contacts that fit at least, where motion from the start does not show them.
    """
    code = files_digest(Path(file) for file in (__file__, slim.__file__))
    return cached(
        ("capacity", code, model_digest(model), start.tolist(), least_contacts),
        make=lambda: _measure(model, start, least_contacts),
        save=lambda capacity: array_bytes(np.array(astuple(capacity))),
        load=lambda content: Capacity(*array_from_bytes(content).tolist()),
    )


def _measure(model: mujoco.MjModel, start: np.ndarray, least_contacts: int = 0) -> Capacity:
    """Measure what `calibrate` returns."""
    pairs = np.array(sorted(slim.colliding_pairs(model)), dtype=int).reshape(-1, 2)
    rows = int(model.jnt_limited.sum() + model.tendon_limited.sum())
    rows += int((model.dof_frictionloss > 0).sum() + (model.tendon_frictionloss > 0).sum())
    rows += 6 * model.neq
    if not len(pairs):
        return Capacity(contacts=0, rows=max(rows, 1), peak_contacts=0)
    with _unwarned():
        counts = np.array([(data.ncon, _candidates(model, data, pairs)) for data in _motion(model, start)])
    peak, mean_candidates = counts[:, 0].max(), counts[:, 1].mean()
    contacts = max(1, least_contacts, int(np.ceil(MARGIN * peak)))
    condim = max(int(model.geom_condim.max()), int(model.pair_dim.max(initial=1)))
    rows += contacts * max(1, 2 * (condim - 1))
    # The pool is shared by all worlds and holds candidates that pass a finer filter, less than half.
    pool = max(contacts, int(np.ceil(mean_candidates)))
    return Capacity(contacts=pool, rows=rows, peak_contacts=int(peak))


@contextlib.contextmanager
def _unwarned() -> Iterator[None]:
    """Have MuJoCo C start again without a word where the random motion of a block gets unstable.

    It would write a file into the user's folder.
    """
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


def _candidates(model: mujoco.MjModel, data: mujoco.MjData, pairs: np.ndarray) -> int:
    """Return how many pairs of geoms have overlapping bounding spheres; planes overlap everything."""
    first, second = pairs.T
    radius, margin = model.geom_rbound, model.geom_margin
    distance = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1)
    reach = radius[first] + radius[second] + margin[first] + margin[second]
    plane = (radius[first] == 0) | (radius[second] == 0)
    return int(np.count_nonzero(plane | (distance <= reach)))


def _motion(model: mujoco.MjModel, start: np.ndarray) -> Iterator[mujoco.MjData]:
    """Yield states of MuJoCo C: random controls from the start, drawn uniformly or at their extremes."""
    rng = np.random.default_rng(0)
    data = mujoco.MjData(model)
    low, high = model.actuator_ctrlrange.T
    for episode in range(NUM_EPISODES):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = start
        for step in range(EPISODE_STEPS):
            if step % HOLD_STEPS == 0:
                draw = rng.uniform(size=model.nu)
                data.ctrl[:] = low + (high - low) * (draw.round() if episode % 2 else draw)
            mujoco.mj_step(model, data)
            yield data
