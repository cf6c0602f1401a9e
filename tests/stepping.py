"""The engine's physics step of a scene, whole or in part, with some stages of ours."""

from myowarp.engine.step import stage_launches


def step(scene, stages=()):
    """Launch a physics step."""
    for launch in stage_launches(stages).values():
        launch(scene.model, scene.data)


def forward(scene, stages=()):
    """Launch all of a physics step but its end: positions, velocities and time stay."""
    for place, launch in stage_launches(stages).items():
        if place != "integrate":
            launch(scene.model, scene.data)


def launch_place(scene, place, stages=()):
    """Launch one place of the step."""
    stage_launches(stages)[place](scene.model, scene.data)
