"""The paper's learning curves, from the logs of its natural policy gradient in a wheel of MyoSuite.

    pip download --no-deps myosuite==2.12.2
    python -m benchmarks.npg_curves myosuite-2.12.2-py3-none-any.whl

It writes numbers alone: samples, and the share of an iteration's 96 sampled trajectories with more than 5
solved steps, as a trailing mean of up to 50 iterations.
"""

import csv
import io
import json
import re
import sys
import zipfile
from pathlib import Path

import numpy as np

from myowarp.apps.studies.reproduce.baselines import NPG

LOG = re.compile(r"baslines_NPG/.*env=([^,]+),seed=(\d+)/logs/log\.csv$")
POINTS, WINDOW = 40, 50
SOURCE = "myosuite/agents/baslines_NPG of MyoSuite 2.12.2, Apache-2.0; release of February 2022, 8 cores"
RULE = "share of 96 sampled trajectories with more than 5 solved steps, trailing mean of up to 50 iterations"


def curve(text: str) -> dict[str, list[float]]:
    """Return samples and success [1] at points that are even in the logarithm."""
    rows = list(csv.DictReader(io.StringIO(text)))
    samples = np.cumsum([float(row["num_samples"]) for row in rows])
    success = np.array([float(row["success_percentage"]) for row in rows]) / 100.0
    places = np.unique(np.geomspace(1, len(rows), POINTS).astype(int)) - 1
    window = [min(WINDOW, max(1, place // 4)) for place in places]
    means = [success[place + 1 - w : place + 1].mean() for place, w in zip(places, window, strict=True)]
    return {"samples": samples[places].tolist(), "success": np.round(means, 4).tolist()}


def main() -> None:
    """Read the logs of a wheel."""
    found: dict[str, dict[str, dict[str, list[float]]]] = {}
    with zipfile.ZipFile(Path(sys.argv[1])) as wheel:
        for name in sorted(wheel.namelist()):
            if (match := LOG.search(name)) and "Exo" not in name:
                found.setdefault(match[1], {})[match[2]] = curve(wheel.read(name).decode())
    text = json.dumps({"source": SOURCE, "rule": RULE, "curves": found}, separators=(",", ":"))
    NPG.write_text(re.sub(r'("(?:myo|motor)\w+-v0":)', r"\n\1", text) + "\n")


if __name__ == "__main__":
    main()
