"""Recorded motions: files of tables over time."""
