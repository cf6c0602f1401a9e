"""Policies: trained ones, baselines, controls from a file, hold."""
