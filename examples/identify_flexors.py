"""Peak force and slack length of three elbow flexors, identified from torque and angle, with 95 % intervals.

A dynamometer holds the elbow at 13 angles, each with six patterns of known activations (EMG). The torques
are simulated: Millard's muscles with elastic tendons, known parameters, 0.1 N m of noise. The fit starts
15 % off, and its Jacobian comes from `wp.Tape`, through the equilibrium of fiber and tendon. The intervals
are those of a linearised fit.

Run: python examples/identify_flexors.py
"""

import mujoco
import numpy as np
import warp as wp
from scipy import optimize, stats

import myowarp
from myowarp.muscle import Muscles

FLEXORS = ("BIClong", "BICshort", "BRA")
FITTED = ("max_isometric_force", "tendon_slack_length")
TRUE = {
    "max_isometric_force": np.array([525.1, 316.8, 1177.4]),  # N
    "tendon_slack_length": np.array([0.272, 0.192, 0.054]),  # m
}
FIBERS = {
    "optimal_fiber_length": np.array([0.116, 0.132, 0.086]),  # m
    "pennation_angle_at_optimal": np.zeros(3),
}
ANGLES = np.linspace(0.1, 2.1, 13)  # rad
PATTERNS = 6
NOISE = 0.1  # N m


def paths(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lengths and moment arms of the flexors of the elbow [m], shape (angles, 3) each."""
    model = myowarp.BODIES["elbow"].build().compile()
    data, tendons = mujoco.MjData(model), [model.actuator(name).trnid[0] for name in FLEXORS]
    joint = model.joint("r_elbow_flex")
    length, arm = [], []
    for angle in angles:
        found = []
        for value in (angle - 1e-4, angle, angle + 1e-4):
            data.qpos[joint.qposadr[0]] = value
            mujoco.mj_forward(model, data)
            found.append(data.ten_length[tendons].copy())
        length.append(found[1])
        arm.append((found[0] - found[2]) / 2e-4)
    return np.array(length), np.array(arm)


class Flexors:
    """Torques of the flexors under some parameters; every sample has muscles of its own, for the Jacobian."""

    def __init__(self, activation: np.ndarray, length: np.ndarray, arm: np.ndarray) -> None:
        self.arm, samples = arm, len(length)
        fixed = {name: np.tile(values, samples) for name, values in FIBERS.items()}
        start = {name: np.tile(TRUE[name], samples) for name in FITTED}
        self.muscles = Muscles("millard2012", requires_grad=True, **fixed, **start)
        self.activation, self.length = (
            wp.array(values.ravel(), dtype=wp.float64, device="cpu") for values in (activation, length)
        )

    def torque(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return torques [N m], (samples,), and their Jacobian by parameters as shares of the true ones."""
        samples = len(self.arm)
        for name, share in zip(FITTED, parameters.reshape(2, 3), strict=True):
            array = self.muscles.parameters[name]
            array.assign(np.tile(share * TRUE[name], samples))
            array.grad.zero_()
        with wp.Tape() as tape:
            force = self.muscles.equilibrium(self.activation, self.length).tendon_force
        tape.backward(grads={force: wp.array(self.arm.ravel(), dtype=wp.float64, device="cpu")})
        columns = [self.muscles.parameters[name].grad.numpy().reshape(-1, 3) * TRUE[name] for name in FITTED]
        return (force.numpy().reshape(-1, 3) * self.arm).sum(axis=1), np.concatenate(columns, axis=1)


def identify(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return estimates and half widths of their intervals, as shares of the true values, (2, 3) each."""
    rng = np.random.default_rng(seed)
    length, arm = (np.repeat(values, PATTERNS, axis=0) for values in paths(ANGLES))
    activation = rng.uniform(0.05, 1.0, length.shape)
    flexors = Flexors(activation, length, arm)
    measured = flexors.torque(np.ones(6))[0] + rng.normal(0.0, NOISE, len(length))
    start = 1.0 + 0.15 * rng.choice((-1.0, 1.0), 6)
    fit = optimize.least_squares(
        lambda x: flexors.torque(x)[0] - measured, start, lambda x: flexors.torque(x)[1], bounds=(0.5, 1.5)
    )
    freedom = len(measured) - len(start)
    covariance = 2.0 * fit.cost / freedom * np.linalg.inv(fit.jac.T @ fit.jac)
    width = stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(covariance))
    return fit.x.reshape(2, 3), width.reshape(2, 3)


if __name__ == "__main__":
    found, width = identify()
    for name, unit, values, widths in zip(FITTED, ("N", "m"), found, width, strict=True):
        for muscle, true, share, half in zip(FLEXORS, TRUE[name], values, widths, strict=True):
            print(f"{name} of {muscle}: {share * true:.4g} ± {half * true:.2g} {unit}, true {true:.4g}")
