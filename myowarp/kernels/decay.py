"""e^x for x <= 88 in SIMD lanes: the template `lanes::decay` of native functions."""

from pathlib import Path

DECAY = Path(__file__).with_suffix(".cpp")
