"""The kit for a GPU machine without internet: packed into parts, unpacked and run from there alone."""

import os
import subprocess
import sys
from pathlib import Path

from benchmarks.gpu_kit import pack

MEASURE = """
import os, sys
from pathlib import Path
size = Path("payload").stat().st_size
output = Path(sys.argv[sys.argv.index("--output") + 1])
output.write_text(f"{size} {os.environ['WARP_CACHE_PATH']} {sys.argv[-1]}")
"""


def test_kit_is_split_and_measures_from_itself(tmp_path):
    kit, parts, out = (tmp_path / name for name in ("kit", "parts", "out"))
    (kit / "benchmarks").mkdir(parents=True)
    (kit / "benchmarks" / "__init__.py").touch()
    (kit / "benchmarks" / "gpu.py").write_text(MEASURE)
    (kit / "payload").write_bytes(os.urandom(25_000))
    pack(kit, parts, size="10kB")
    sizes = [part.stat().st_size for part in sorted(parts.glob("part*"))]
    assert len(sizes) == 3
    assert max(sizes) == 10_000
    command = [parts / "run.sh", parts, out, "--quick"]
    subprocess.run(command, check=True, cwd=tmp_path, env=os.environ | {"PYTHON": sys.executable})
    size, cache, option = (out / "gpu.json").read_text().split()
    assert (size, option) == ("25000", "--quick")
    assert cache.endswith("/warp")
    assert not Path(cache).exists()  # nothing is left
