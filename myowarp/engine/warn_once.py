"""What is said once in a process, such as that something is slower than it could be, and why."""

import logging
from functools import cache

logger = logging.getLogger("myowarp")


@cache
def warn_once(message: str) -> None:
    """Log a message, the first time only."""
    logger.warning(message)
