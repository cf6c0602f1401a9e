"""Many runs, one result: the paper's experiments, audits, cohorts, sweeps."""
