"""From a setup as a user says it to one that can be built: the id's own reset and conditions, all checked."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from myowarp.definitions.condition import resolve
from myowarp.definitions.setup import CONTACTS, Setup
from myowarp.definitions.task import TaskSpec
from myowarp.sim.build import check_device_name, checked_horizon
from myowarp.tasks.from_file import pose_task
from myowarp.tasks.outside import find_task
from myowarp.tasks.variants import Variant


def variant_of(setup: Setup) -> Variant:
    """Return what a setup's task stands for: an id, a task of a user's file, or a model's file.

    Raises:
        ValueError: There is no such task, or the file is unsuitable.
    """
    task = setup.task
    if isinstance(task, Path):
        return Variant(pose_task(task, setup.stops is not False, setup.contact or CONTACTS[0]).key)
    for name, verb in (("stops", "are"), ("contact", "is")):
        if getattr(setup, name) is not None:
            raise ValueError(
                f"{name} {verb} an option of a model's file; give it with --model FILE, or to from_osim"
            )
    if isinstance(task, TaskSpec):
        return Variant(task.key)
    if task is None:
        raise ValueError("what to run is a task id or --model with a file, one of them; got neither")
    return find_task(task)


def complete(what: Setup | TaskSpec | str | Path) -> Setup:
    """Return a setup that can be built: nothing of it is open but the horizon, the device and the shards.

    Args:
        what: A setup, or a task alone: its id, with or without "MyoWarp/", file.py:name, or the path of an
            MJCF file. A complete setup is returned as it is.

    Raises:
        ValueError: There is no such task, or a value is wrong for it; nothing was built.
        OSError: The file of muscle parameters cannot be read.
    """
    setup = Setup.of(what)
    variant = variant_of(setup)  # a user's file may bring the muscles and conditions that are named
    setup.check()
    check_device_name(setup.device)
    if not isinstance(setup.task, TaskSpec):
        setup = dataclasses.replace(setup, task=variant.task, stops=None, contact=None)
    setup = setup.over(Setup(reset=variant.reset)).finished()
    if setup.horizon is not None:
        checked_horizon(setup.horizon)
    conditions = (*variant.conditions, *(setup.conditions or ()))
    resolve(conditions, setup.spec)
    return dataclasses.replace(setup, muscle=setup.muscles, muscle_parameters=None, conditions=conditions)
