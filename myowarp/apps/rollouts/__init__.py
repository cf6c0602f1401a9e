"""Policies at work in worlds: what they do, measured, filmed and recorded."""
