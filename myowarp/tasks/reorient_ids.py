"""The reorient ids: four tables of shapes, as MyoSuite has them (v0) and on a free joint (v1)."""

from myowarp.definitions.task import task
from myowarp.tasks.reorient import SPINNING, ReorientTask

FREE = (
    "The object has a free joint; in v0, as in MyoSuite 3.0.0, it loses a direction of rotation where the"
    " second of its three hinges is at a right angle, its rates are about turned axes, and a few of ten"
    " thousand random steps have no finite result."
)


@task("myoHandReorient8-v1", FREE, free=True)
@task("myoHandReorient8-v0")
def reorient_8() -> ReorientTask:
    """Turn one of eight objects on the hand to a direction drawn anew each episode."""
    return ReorientTask(table="8", condim=SPINNING)


@task("myoHandReorient100-v1", FREE, free=True)
@task("myoHandReorient100-v0")
def reorient_100() -> ReorientTask:
    """Turn one of a hundred objects on the hand to a direction drawn anew each episode."""
    return ReorientTask(table="100")


@task("myoHandReorientID-v1", FREE, free=True)
@task("myoHandReorientID-v0")
def reorient_in_distribution() -> ReorientTask:
    """Turn one of a thousand objects like those of the hundred on the hand to a random direction."""
    return ReorientTask(table="id")


@task("myoHandReorientOOD-v1", FREE, free=True)
@task("myoHandReorientOOD-v0")
def reorient_out_of_distribution() -> ReorientTask:
    """Turn one of a thousand objects unlike those of the hundred on the hand to a random direction."""
    return ReorientTask(table="ood")
