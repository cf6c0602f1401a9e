"""A muscle model with a state of its own: the tension follows the fibers' with a time constant."""

from dataclasses import replace

import warp as wp

import myowarp

TIME_CONSTANT = wp.constant(0.02)  # s


@wp.kernel(enable_backward=False)
def stretch(
    timestep: wp.array[float],
    anatomy: myowarp.Anatomy,
    velocity: wp.array2d[float],
    tendon_force: wp.array3d[float],
    tension: wp.array2d[float],
    damping: wp.array2d[float],
    actuator_biasprm: wp.array2d[myowarp.BiasParams],
):
    """dT/dt = (F - T) / tau."""
    worldid, muscleid = wp.tid()
    dt = timestep[myowarp.batched(worldid, timestep.shape[0])]
    force = tendon_force[worldid, muscleid, 0]
    tendon_force[worldid, muscleid, 0] = force + (1.0 - wp.exp(-dt / TIME_CONSTANT)) * (
        tension[worldid, muscleid] - force
    )
    tension[worldid, muscleid] = force
    damping[worldid, muscleid] = 0.0
    path = anatomy.path[myowarp.batched(worldid, anatomy.path.shape[0]), muscleid]
    actuator_biasprm[worldid, path] = myowarp.affine_bias(force, 0.0, velocity[worldid, muscleid])


@myowarp.MUSCLES.register("outside_elastic")
class ElasticMuscle(myowarp.MujocoMuscle):
    """`MujocoMuscle` with a state of its own."""

    STATE = (*myowarp.MujocoMuscle.STATE, "tendon_force")

    def __init__(self, model, num_worlds, parameters=None):
        super().__init__(model, num_worlds, parameters)
        self.tendon_force = wp.zeros((num_worlds, len(self.names), 1), dtype=float)

    def launch(self, model, data):
        super().launch(model, data)
        myowarp.launch(stretch, self.tension.shape, self, model, model.opt)


@myowarp.task("outsideElbowElastic-v0")
def elastic():
    """Bring the elbow to an angle; run it with --muscle outside_elastic."""
    return replace(myowarp.TASKS["myoElbowPose1D6MFixed-v0"], horizon=30)
