"""Joints that follow others: q_i = f_i(q_j), f_i piecewise polynomial.

MuJoCo has a joint equality for that, one quartic, held by a spring. A model may carry better: a text named
`couplings` (what `myowarp convert` writes as `couplings.json` beside `model.xml`) with the document's own
functions, and with the masses and moments of inertia that MuJoCo refuses. Such a model asks for coordinates
that follow exactly (`coordinates.free_coordinates`); a text without functions asks so for its equalities.

Source: MuJoCo documentation, *XML reference, equality/joint*: q_i - q0_i = sum_k c_k (q_j - q0_j)^k, k <= 4.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from myowarp.laws.pieces import Pieces, chain_of
from myowarp.osim.bundle.text import Sidecar, scalar_joints

REGULAR = 1e-9
"""Least `regularity` of a mass matrix along free coordinates with which float32 finds accelerations."""


@dataclass(frozen=True)
class Coupling:
    """A joint that follows.

    Attributes:
        joint: Id of the joint.
        driver: Id of the joint that it follows, which follows none itself unless joints follow each other in
            a ring; -1 for none, it then stays where it is put.
        curves: The joint's value is last(...(first(driver's value))).
    """

    joint: int
    driver: int
    curves: tuple[Pieces, ...]

    def derivatives(self, x: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the joint's value, slope and second derivative at driver's values `x`, in its shape."""
        value = np.asarray(x, float)
        slope, bend = np.ones(value.shape), np.zeros(value.shape)
        for curve in self.curves:
            value, outer, outer_bend = curve.derivatives(value)
            slope, bend = outer * slope, outer_bend * slope**2 + outer * bend
        return value, slope, bend


@dataclass(frozen=True)
class Couplings(Sidecar):
    """Joints that follow others exactly, and masses of bodies.

    Attributes:
        curves: Of joints that follow, by name: the joint that each follows, None for none, and its curves.
        bodies: Mass [kg] and principal moments of inertia [kg m^2], in the model's axes, of bodies that are
            heavier in the model, because MuJoCo needs it.
    """

    NAME, FILE = "couplings", "couplings.json"
    KEYS = "'joints' and 'bodies'"
    curves: Mapping[str, tuple[str | None, tuple[Pieces, ...]]]
    bodies: Mapping[str, tuple[float, tuple[float, ...]]]

    @property
    def acts(self) -> bool:
        """Whether a joint follows, or a body with a mass has other moments of inertia than in the model."""
        return bool(self.curves) or any(mass > 0 for mass, _ in self.bodies.values())

    @property
    def bodies_apart(self) -> Iterable[str]:
        """Bodies that are weighed."""
        return self.bodies

    @classmethod
    def from_entry(cls, entry: Any) -> Self:
        """Return what parsed JSON says; see `Sidecar.from_entry`."""
        return cls({joint: driven(e) for joint, e in entry["joints"].items()}, _bodies(entry["bodies"]))

    def as_json(self) -> str:
        """Return the text."""
        curves = {joint: entry_of(*follows) for joint, follows in self.curves.items()}
        bodies = {name: {"mass": mass, "inertia": inertia} for name, (mass, inertia) in self.bodies.items()}
        return json.dumps({"joints": curves, "bodies": bodies})

    def check(self, model: mujoco.MjModel) -> None:
        """Raise ValueError if it names joints that a model has not."""
        named = {*self.curves, *(of for of, _ in self.curves.values() if of is not None)}
        self.check_named("hinge or slide", named, scalar_joints(model))


NOTHING = Couplings({}, {})
"""Asks that joint equalities be exact."""


def entry_of(of: str | None, curves: Iterable[Pieces]) -> dict[str, Any]:
    """Return a value that follows a joint as `driven` reads it."""
    return {"of": of, "curves": [piece.entry() for piece in curves]}


def driven(entry: Mapping[str, object]) -> tuple[str | None, tuple[Pieces, ...]]:
    """Return the joint that an entry of a text follows, None for none, and its curves.

    Raises:
        ValueError: Its pieces are broken.
        KeyError: It has no joint or no curves.
    """
    of, curves = entry["of"], entry["curves"]
    return (None if of is None else str(of)), chain_of(curves)  # type: ignore[arg-type]


def _bodies(entries: Mapping[str, Mapping[str, object]]) -> dict[str, tuple[float, tuple[float, ...]]]:
    bodies = {}
    for name, entry in entries.items():
        mass, inertia = np.array(entry["mass"], float), np.array(entry["inertia"], float)
        if mass.shape or inertia.shape != (3,) or not (mass >= 0 and np.isfinite([mass, *inertia]).all()):
            raise ValueError(f"body {name!r} needs a mass and three moments of inertia")
        bodies[name] = float(mass), tuple(inertia.tolist())
    return bodies


def couplings(model: mujoco.MjModel) -> list[Coupling]:
    """Return the active couplings of a model, each from the joint at the root of its chain.

    What the model's text says comes before its equalities of the same joint.
    """
    said = Couplings.of(model) or NOTHING
    waiting = [
        Coupling(model.joint(joint).id, -1 if of is None else model.joint(of).id, curves)
        for joint, (of, curves) in said.curves.items()
    ]
    ties = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & model.eq_active0.astype(bool)
    for i in np.flatnonzero(ties):
        joint, driver = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        if model.joint(joint).name not in said.curves:
            waiting.append(_equality(model, joint, driver, model.eq_data[i, :5].tolist()))
    ordered: list[Coupling] = []
    chains: dict[int, Coupling] = {}
    while waiting:
        late = {coupling.joint for coupling in waiting}
        ready = [coupling for coupling in waiting if coupling.driver not in late]
        for coupling in ready or waiting:  # a ring has no beginning
            before = chains.get(coupling.driver)
            if before is not None:
                coupling = Coupling(coupling.joint, before.driver, before.curves + coupling.curves)
            ordered.append(coupling)
        chains |= {coupling.joint: coupling for coupling in ordered} if ready else {}
        waiting = [coupling for coupling in waiting if ready and coupling.driver in late]
    return ordered


def _equality(model: mujoco.MjModel, joint: int, driver: int, polynomial: list[float]) -> Coupling:
    """Return a joint equality as a coupling."""
    own = float(model.qpos0[model.jnt_qposadr[joint]])
    if driver < 0:
        return Coupling(joint, -1, (Pieces((0.0,), ((own + polynomial[0],),)),))
    start = float(model.qpos0[model.jnt_qposadr[driver]])
    return Coupling(joint, driver, (Pieces((start,), ((own + polynomial[0], *polynomial[1:]),)),))


def follow(model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Put the joints that follow to where their drivers are in `qpos` (nq,), in place."""
    for coupling in couplings(model):
        driver, address = model.jnt_qposadr[[coupling.driver, coupling.joint]]
        qpos[address] = coupling.derivatives(qpos[driver] if coupling.driver >= 0 else 0.0)[0]


def jacobian(
    model: mujoco.MjModel, ties: Sequence[Coupling], qpos: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how degrees of freedom move with those that follow none.

    Args:
        model: The model.
        ties: Its `couplings`.
        qpos: Positions, shape (..., nq).

    Returns:
        The dofs that follow none, (n,); dq/du, shape (..., nv, n); and d2q/du2 of each dof by the one that it
        follows, shape (..., nv).
    """
    followers = model.jnt_dofadr[[tie.joint for tie in ties]] if ties else ()
    free = np.setdiff1d(np.arange(model.nv), followers)
    shape = (*qpos.shape[:-1], model.nv)
    slopes, bends = np.zeros((*shape, len(free))), np.zeros(shape)
    slopes[..., free, np.arange(len(free))] = 1.0
    for tie in ties:
        if tie.driver >= 0:
            dof, driver = model.jnt_dofadr[[tie.joint, tie.driver]]
            _, slope, bends[..., dof] = tie.derivatives(qpos[..., model.jnt_qposadr[tie.driver]])
            slopes[..., dof, free == driver] = slope[..., None]
    return free, slopes, bends


def regularity(M: np.ndarray) -> float:
    """Return the least eigenvalue of a mass matrix, its diagonal scaled to 1; 0 if that has a zero."""
    scale = np.sqrt(np.diag(M).clip(min=0.0))
    scaled = M / scale[:, None] / scale if scale.all() else np.zeros_like(M)
    return float(np.linalg.eigvalsh(scaled)[0]) if np.isfinite(scaled).all() else 0.0
