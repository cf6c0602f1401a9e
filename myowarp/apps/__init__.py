"""The lab: command line, rollouts, policies, recordings, audits, cohorts."""
