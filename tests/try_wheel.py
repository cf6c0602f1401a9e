"""The wheel at work: python tests/try_wheel.py dist/myowarp-0.1.0-py3-none-any.whl

Installs it into an empty environment and runs there, away from the repository, what a stranger would: the
first Python snippet of the README, a rollout with a policy of the package, a result, and a converted model.
"""

import re
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST_BYTES = 10e6
NEEDED = (
    "myowarp/py.typed",
    "myowarp/kernels/action.cpp",
    "/policy.safetensors",
    "/presets/myoHandReachFixed.toml",
    "/reproduce/exo1.md",
    "/audit/figures.md",
    "/audit/page.html",
)


def main() -> None:
    """Try the wheel; any failure raises."""
    wheel = Path(sys.argv[1]).resolve()
    size = wheel.stat().st_size
    assert size <= MOST_BYTES, (
        f"{wheel.name} has {size / 1e6:.1f} MB, at most {MOST_BYTES / 1e6:.0f} MB are wanted"
    )
    names = zipfile.ZipFile(wheel).namelist()
    for needed in NEEDED:
        assert any(needed in name for name in names), f"{wheel.name} lacks {needed}"
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        venv.create(here / "venv", with_pip=True)
        bin_ = here / "venv/bin"

        def run(*command: str | Path) -> None:
            print("$", *command, flush=True)
            subprocess.run([str(word) for word in command], cwd=here, check=True)

        run(bin_ / "pip", "install", "--quiet", "--disable-pip-version-check", f"{wheel}[convert,plot]")
        (here / "snippet.py").write_text(
            re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)[0]
        )
        run(bin_ / "python", "snippet.py")
        task = "myoElbowPose1D6MRandom-v0"
        run(
            bin_ / "myowarp", "rollout", task, "--policy", f"baselines/{task}", "--num-worlds", "16", "--json"
        )
        run(bin_ / "myowarp", "reproduce", "speed", "--output", "speed")
        run(bin_ / "myowarp", "convert", ROOT / "tests/data/osim/arm26.osim", "--output", "arm26")
        run(
            bin_ / "myowarp",
            "rollout",
            "--model",
            "arm26/model.xml",
            "--num-worlds",
            "4",
            "--steps",
            "20",
            "--json",
        )
    print(f"{wheel.name}, {size / 1e6:.1f} MB, works in an empty environment.")


if __name__ == "__main__":
    main()
