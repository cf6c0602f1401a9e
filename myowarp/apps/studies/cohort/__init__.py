"""Cohorts: a table of patients, one policy, all patients simulated at once, tidy results.

    result = run_cohort("patients.csv", "myoElbowPose1D6MRandom-v0", policy="hold", trials=4)
    result.summary.groupby("load_mass")["final_error"].median()

    myowarp cohort patients.csv --task myoElbowPose1D6MRandom-v0 --output results

A row of the table is a patient; its columns (`COLUMNS`) set parameters of muscle conditions. Missing
columns default to healthy.
"""

from myowarp.apps.studies.cohort.run import CohortResult, run_cohort
from myowarp.sim.patient_columns import COLUMNS

__all__ = ["COLUMNS", "CohortResult", "run_cohort"]
