"""Definitions, before any array exists: task, body, muscle model, condition, parameter, scene."""
