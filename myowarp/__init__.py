"""MyoWarp: musculoskeletal motor control, simulated in thousands of worlds at once.

Importing the package registers every task with Gymnasium under `MyoWarp/<name>-v<version>`.
"""

import gc

# Warp parses the kernels of its modules on import: half a million objects that stay. Without looking
# through them again and again for garbage, now and later, start and exit take two seconds less.
_collects = gc.isenabled()
gc.disable()

import myowarp.tasks  # noqa: E402, F401  (registers the tasks)
from myowarp.bridge_gym import register_all  # noqa: E402

register_all()

gc.freeze()
if _collects:
    gc.enable()
