"""Stages of the physics step that kernels of ours do, one file each with its kernels."""
