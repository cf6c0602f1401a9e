"""Sarcopenia as the MyoSuite paper means it: the peak isometric force is scaled, nothing else.

Source: Caggiano et al. (2022), arXiv:2205.13600: half of the maximal isometric force is left.
"""

PAPER = 0.5


def force(healthy, passive, strength):
    """Force [N] of a weak muscle: its active part, all but the passive one, is scaled."""
    return strength * (healthy - passive) + passive
