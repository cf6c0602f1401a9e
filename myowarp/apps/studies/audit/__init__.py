"""Whether a task is sound: what policies that know nothing meet in it, and what its geometry allows.

    audit(TASKS["myoHandReachFixed-v1"]).targets.solvable

`audit` measures one task; `command` does it for many and writes JSON, a page and a table.
"""

from myowarp.apps.studies.audit.measure import Audit, audit

__all__ = ["Audit", "audit"]
