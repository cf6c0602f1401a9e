"""Paths of muscles other than MuJoCo's tendons."""
