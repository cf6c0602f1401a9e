"""The engine's physics step of a scene, whole or in part, with some stages of ours."""

import warp as wp

from myowarp.engine.graph import Graph
from myowarp.engine.patch import engine_kernels_alone
from myowarp.engine.step import stage_launches


def engine_alone(launches):
    """Return a function of the engine that launches from small modules: whole ones compile for seconds."""

    def launched(*args, **kwargs):
        with engine_kernels_alone():
            return launches(*args, **kwargs)

    return launched


def launches(scene, stages):
    """Return what a physics step launches, by place."""
    return stage_launches(stages, ground=getattr(scene, "ground", None))


def step(scene, stages=()):
    """Launch a physics step."""
    with engine_kernels_alone():
        for launch in launches(scene, stages).values():
            launch(scene.model, scene.data)


def forward(scene, stages=()):
    """Launch all of a physics step but its end: positions, velocities and time stay."""
    with engine_kernels_alone():
        for place, launch in launches(scene, stages).items():
            if place != "integrate":
                launch(scene.model, scene.data)


def launch_place(scene, place, stages=()):
    """Launch one place of the step."""
    with engine_kernels_alone():
        launches(scene, stages)[place](scene.model, scene.data)


def repeated(launch, device):
    """Return a function that launches the same each time: first as it is, to compile it, then recorded."""
    recorded = []

    def again():
        with wp.ScopedDevice(device):
            if recorded:
                recorded[0].launch()
                return
            launch()
            recorded.append(Graph(launch, wp.get_device(device)))

    return again


def repeated_step(scene, stages=()):
    """Return a function that launches a physics step each time."""
    return repeated(lambda: step(scene, stages), scene.device)


def physics_of(sim):
    """Return a function that launches the physics step of a simulation each time, with its own stages."""
    return repeated(sim.shards[0].launch_physics, sim.scene.device)
