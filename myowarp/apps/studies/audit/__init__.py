"""Whether a task is sound: how untrained policies fare in it, and what its geometry allows.

    audit(TASKS["myoHandReachFixed-v1"]).targets.solvable

`audit` measures one task; `tasks` measures many and writes JSON, a page and a table.
"""

from myowarp.apps.studies.audit.measure import Audit, audit

__all__ = ["Audit", "audit"]
