"""MyoWarp: musculoskeletal motor control, simulated in thousands of worlds at once.

Importing the package registers every task with Gymnasium under `MyoWarp/<name>-v<version>`.
"""

from myowarp.quick_import import quick_import

with quick_import():
    import myowarp.tasks  # noqa: F401  (registers the tasks)
    from myowarp.bridge_gym import register_all

    register_all()
