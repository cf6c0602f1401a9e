"""Memory of what launches allocate for themselves, made before they are captured.

The engine allocates its solver's scratch in each physics step. In a CUDA graph every such array is a node
that allocates and one that frees, and the body of a loop may have neither.
"""

import contextlib
from collections.abc import Callable, Iterator

import warp as wp

from myowarp.engine.compile import recorded
from myowarp.engine.replaced import replaced


class Arena:
    """An allocator of Warp's: the same blocks in the same order, each time that the same launches are made.

    Attributes:
        blocks: Its memory, bytes.
    """

    deallocate_requires_context_guard = False  # read by Warp

    def __init__(self, launches: Callable[[], None], device: wp.Device) -> None:
        """Make all blocks that `launches` needs, without launching.

        Args:
            launches: Launches kernels of a CUDA device.
            device: The device.
        """
        self.blocks: list[wp.array] = []
        self._device, self._own = device, device.get_allocator()
        self._next, self._complete = 0, False
        with self.used(), recorded():
            launches()
        self._complete = True

    @contextlib.contextmanager
    def used(self) -> Iterator[None]:
        """Let arrays that this thread makes in the block lie in the arena, from its first block on."""
        self._next = 0
        with replaced(self._device, "get_allocator", lambda pinned=False: self):
            yield

    def allocate(self, size_in_bytes: int) -> int:
        """Return the address of the next block.

        Raises:
            RuntimeError: It is none of that size.
        """
        if not self._complete:
            with replaced(self._device, "get_allocator", lambda pinned=False: self._own):
                self.blocks.append(wp.empty(size_in_bytes, dtype=wp.uint8, device=self._device))
        sizes = [block.capacity for block in self.blocks[self._next : self._next + 1]]
        if sizes != [size_in_bytes]:
            raise RuntimeError(
                f"the physics step allocates {size_in_bytes} bytes where it allocated {sizes} when it was "
                "compiled, so that it cannot be captured; make the simulation with graph=False"
            )
        self._next += 1
        return int(self.blocks[self._next - 1].ptr)

    def deallocate(self, ptr: int, size_in_bytes: int) -> None:
        """Keep the block, for the next time."""
