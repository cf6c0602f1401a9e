"""Random numbers that depend on (seed, episode, stream) of a world and on nothing else.

No generator state is stored: a world draws the same numbers for any number of worlds, on any shard and
any device, in eager mode and in a replayed graph.
"""

import zlib
from collections.abc import Iterable

import numpy as np
import warp as wp

from myowarp.kernels.structs import zeros_of
from myowarp.kernels.write import write

GOAL = wp.constant(0)
START = wp.constant(1)
POSTURE = wp.constant(2)


@wp.struct
class RandomKeys:
    """Keys from which the numbers of a world are drawn.

    Attributes:
        seed: Seed of each world, shape (num_worlds,).
        episode: Resets of each world since it was seeded, shape (num_worlds,).
    """

    seed: wp.array[wp.int32]
    episode: wp.array[wp.int32]


def new_keys(num_worlds: int) -> RandomKeys:
    """Return keys on the current Warp device, all 0."""
    return zeros_of(RandomKeys, num_worlds)


def seed_worlds(keys: RandomKeys, mask: np.ndarray, seeds: Iterable[int]) -> None:
    """Begin the random numbers of worlds anew; on the host.

    Args:
        keys: The keys of all worlds.
        mask: Which worlds, shape (num_worlds,) bool.
        seeds: Any integers, shape (num_worlds,); their lowest 64 bits count.
    """
    folded = np.array([int(seed) % 2**64 for seed in seeds], dtype=np.uint64)
    folded = (folded ^ (folded >> np.uint64(32))).astype(np.uint32).view(np.int32)
    write(keys.seed, np.where(mask, folded, keys.seed.numpy()))
    write(keys.episode, np.where(mask, 0, keys.episode.numpy()).astype(np.int32))


def stream_of(name: str) -> int:
    """Return the number of the stream that a name has for its own."""
    return zlib.crc32(name.encode()) & 0x7FFFFFFF


@wp.func
def open_stream(keys: RandomKeys, worldid: int, stream: int) -> wp.uint32:
    """Return the state of an independent stream of this world's present episode."""
    episode_state = wp.rand_init(keys.seed[worldid], keys.episode[worldid])
    return wp.rand_init(wp.int32(episode_state), stream)


@wp.func
def open_step_stream(keys: RandomKeys, worldid: int, stream: int, step: int) -> wp.uint32:
    """Return the state of an independent stream of one step of this world's present episode."""
    return wp.rand_init(wp.int32(open_stream(keys, worldid, stream)), step)


@wp.func
def normal_pair(state: wp.uint32) -> wp.vec2:
    """Return two independent numbers ~ N(0, 1): sqrt(-2 ln u1) (cos 2 pi u2, sin 2 pi u2), u1 in (0, 1]."""
    radius = wp.sqrt(-2.0 * wp.log(1.0 - wp.randf(state)))
    angle = 2.0 * wp.pi * wp.randf(state)
    return wp.vec2(radius * wp.cos(angle), radius * wp.sin(angle))
