"""What acts: trained policies, baselines, controls from a file, hold."""
