"""Motor noise in float64 NumPy: the hash, the keys, Box and Muller, the formula.

Sources: Jarzynski and Olano (2020), *Hash functions for GPU rendering*, JCGT 9(3), pcg on 32 bits; Box and
Muller (1958); MyoSuite 3.0.0's formula u + s u n1 + c n2, clipped.
"""

import zlib

import numpy as np

STREAM = zlib.crc32(b"motor_noise") & 0x7FFFFFFF
WORD = 2**32


def pcg(state):
    """One step of the generator; integers below 2^32 in, the same out."""
    state = np.asarray(state, dtype=np.uint64)
    state = (state * 747796405 + 2891336453) % WORD
    word = ((state >> ((state >> np.uint64(28)) + np.uint64(4))) ^ state) * np.uint64(277803737) % WORD
    return (word >> np.uint64(22)) ^ word


def key(state, number):
    """State of a stream `number` of a stream."""
    return pcg((np.asarray(state, dtype=np.uint64) + pcg(np.asarray(number).astype(np.int64) % WORD)) % WORD)


def normals(seed, episode, step, num_muscles):
    """Standard normal numbers (n1, n2), each (num_worlds, num_muscles)."""
    state = np.asarray(seed).astype(np.int64) % WORD
    for number in (episode, STREAM, step):
        state = key(state, number)
    first = pcg(key(state[:, None], np.arange(num_muscles)))
    u1, u2 = ((x >> np.uint64(8)) / 2.0**24 for x in (first, pcg(first)))
    radius, angle = np.sqrt(-2.0 * np.log(1.0 - u1)), 2.0 * np.pi * u2
    return radius * np.cos(angle), radius * np.sin(angle)


def noisy(excitation, signal, constant, n1, n2):
    """Excitation with noise."""
    return np.clip(excitation + signal * excitation * n1 + constant * n2, 0.0, 1.0)
