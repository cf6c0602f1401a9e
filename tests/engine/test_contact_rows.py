"""Constraint rows of contacts against those of MuJoCo C, from the same contacts."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
from constrained import MORE, NUM_CONTACTS, NUM_ROWS, model_of, states

from myowarp.engine.stages.constraint_rows import launch_contact_rows

WORLDS = 2
CLOSE = 2e-5  # of the largest in a state, float32
CONTACTS = (
    int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS),
    int(mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL),
)
WRITTEN = ("D", "aref", "pos", "margin", "vel", "frictionloss", "type", "id")


def on_device(name, host):
    """Return the engine's model and data, two worlds in one state."""
    data = mjw.put_data(model_of(name), host, nworld=WORLDS, njmax=NUM_ROWS, nconmax=NUM_CONTACTS)
    return mjw.put_model(model_of(name)), data


def dense(data, nv):
    """Return J of all worlds with all columns, shape (WORLDS, NUM_ROWS, nv)."""
    J = data.efc.J.numpy()
    if not data.efc.J_rownnz.shape[1]:
        return J[:, :NUM_ROWS, :nv].copy()
    full = np.zeros((WORLDS, NUM_ROWS, nv))
    number, address, column = (
        getattr(data.efc, f"J_{part}").numpy() for part in ("rownnz", "rowadr", "colind")
    )
    for world, row in np.ndindex(WORLDS, NUM_ROWS):
        places = address[world, row] + np.arange(number[world, row])
        full[world, row, column[world, 0, places]] = J[world, 0, places]
    return full


@pytest.mark.parametrize("name", MORE)
def test_rows_are_those_of_mujoco_c(name):
    nv, dims = model_of(name).nv, set()
    for host in states(name)[::2]:
        model, data = on_device(name, host)
        rows = np.flatnonzero(np.isin(host.efc_type, CONTACTS))
        dims |= set(host.contact.dim)
        expected = {part: getattr(data.efc, part).numpy()[:, rows].copy() for part in WRITTEN}
        expected["J"] = dense(data, nv)[:, rows]
        expected["vel"] = expected["J"] @ host.qvel
        expected["id"] = host.efc_id[rows] + host.ncon * np.arange(WORLDS)[:, None]
        for part in WRITTEN:
            array = getattr(data.efc, part)
            values = array.numpy()
            values[:, rows] = -7
            array.assign(values)
        places = data.efc.J.numpy()
        if data.efc.J_rownnz.shape[1]:
            first = data.efc.J_rowadr.numpy()[0, rows[0]]
            places[:, 0, first : data.efc.J_rownnz.numpy()[0].sum()] = np.nan
        else:
            places[:, rows] = np.nan
        data.efc.J.assign(places)
        launch_contact_rows(model, data)
        assert np.isfinite(dense(data, nv)).all()
        for part, theirs in expected.items():
            ours = dense(data, nv) if part == "J" else getattr(data.efc, part).numpy()
            error = np.abs(ours[:, rows] - theirs).max()
            assert error <= CLOSE * max(np.abs(theirs).max(), 1e-3), part
    assert dims >= ({3, 4, 6} if name == "wide" else {1, 3, 4, 6})


@pytest.mark.parametrize("name", MORE)
def test_only_rows_of_contacts_are_written(name):
    host = states(name)[0]
    model, data = on_device(name, host)
    before = {part: getattr(data.efc, part).numpy().copy() for part in WRITTEN}
    full = dense(data, model.nv)
    others = np.flatnonzero(~np.isin(host.efc_type, CONTACTS))
    beyond = np.arange(host.nefc, NUM_ROWS)
    launch_contact_rows(model, data)
    for part, theirs in before.items():
        for rows in (others, beyond):
            assert np.array_equal(getattr(data.efc, part).numpy()[:, rows], theirs[:, rows])
    assert np.array_equal(dense(data, model.nv)[:, others], full[:, others])


def test_rows_beyond_the_capacity_are_dropped():
    """A contact that begins in the last row of a world writes that one, and none of the next world."""
    host = states("dense")[0]
    model, data = on_device("dense", host)
    contact = int(np.flatnonzero(host.contact.dim > 1)[0])
    places = data.contact.efc_address.numpy()
    places[contact, 0] = NUM_ROWS - 1
    data.contact.efc_address.assign(places)
    before = data.efc.aref.numpy().copy()
    launch_contact_rows(model, data)
    aref = data.efc.aref.numpy()
    assert aref[0, NUM_ROWS - 1] != before[0, NUM_ROWS - 1]
    others = np.flatnonzero(~np.isin(host.efc_type, CONTACTS))
    assert np.array_equal(aref[1, others], before[1, others])
