"""What people run: command line, rollouts, policies, recordings, audits, cohorts."""
