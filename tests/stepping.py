"""The engine's physics step of a scene, whole or in part, with some stages of ours."""

from myowarp.engine.step import stage_launches


def launches(scene, stages):
    """Return what a physics step launches, by place."""
    return stage_launches(stages, ground=getattr(scene, "ground", None))


def step(scene, stages=()):
    """Launch a physics step."""
    for launch in launches(scene, stages).values():
        launch(scene.model, scene.data)


def forward(scene, stages=()):
    """Launch all of a physics step but its end: positions, velocities and time stay."""
    for place, launch in launches(scene, stages).items():
        if place != "integrate":
            launch(scene.model, scene.data)


def launch_place(scene, place, stages=()):
    """Launch one place of the step."""
    launches(scene, stages)[place](scene.model, scene.data)
