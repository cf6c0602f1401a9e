"""MyoWarp: musculoskeletal motor control, simulated in thousands of worlds at once.

Importing the package registers every task with Gymnasium under `MyoWarp/<name>-v<version>`.
"""

from myowarp.engine.quick_import import quick_import

with quick_import():
    import myowarp.models.bodies
    import myowarp.models.conditions
    import myowarp.models.muscles
    import myowarp.tasks  # noqa: F401  (these register themselves)
    from myowarp.bridge_gym import register_all

    register_all()
