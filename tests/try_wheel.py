"""The wheel at work: python tests/try_wheel.py dist/myowarp-0.1.0-py3-none-any.whl [OLDER_WHEEL]

Installs it into an empty environment, over an older one if that is given, and runs there, away from the
repository, what a stranger would: README's first Python snippet, the demo, the examples, a policy of the
package, a converted model, a cohort, the page; and the demo once more with uvx.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST_BYTES = 11e6  # measured 10.1e6, of which policies 7e6
NEEDED = (
    "myowarp/py.typed",
    "myowarp/kernels/action.cpp",
    "/policy.safetensors",
    "/presets/myoHandReachFixed.toml",
    "/reproduce/exo1.md",
    "/audit/figures.md",
    "/audit/page.html",
    "/examples/arm.osim",
    "/pictures/demo.gif",
)
ELBOW = "myoElbowPose1D6MRandom-v0"


def main() -> None:
    """Try the wheel; any failure raises."""
    wheel, *older = (Path(name).resolve() for name in sys.argv[1:])
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
        myowarp = str(bin_ / "myowarp")

        def run(*command: str | Path, **more: str) -> None:
            print("$", *command, flush=True)
            subprocess.run([str(word) for word in command], cwd=here, check=True, env=os.environ | more)

        pip = (bin_ / "pip", "install", "--quiet", "--disable-pip-version-check")
        act = ("--policy", f"baselines/{ELBOW}", "--num-worlds", "16", "--json")
        rollout = (myowarp, "rollout", ELBOW, *act)
        for own in (*older, wheel):
            run(*pip, f"{own}[cohort,convert,plot,view]")
            run(*pip, "--force-reinstall", "--no-deps", own)
            if older:  # the newer one finds what the older one has left on the disk
                run(*rollout, **caches(here / "upgraded"))
        (here / "snippet.py").write_text(
            re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)[0]
        )
        run(bin_ / "python", "snippet.py")
        for start in ("first", "second"):
            print(f"{start} start: {serve(here, myowarp, 'demo', '--port', '0'):.0f} s", flush=True)
        run(*rollout)
        run(myowarp, "reproduce", "speed", "--output", "speed")
        run(myowarp, "examples", "--copy")
        run(myowarp, "rollout", "examples/own_task.py:thrifty", "--policy", "hold", "--steps", "20", "--json")
        run(myowarp, "convert", "examples/arm.osim", "--output", "out/arm")
        run(bin_ / "python", "examples/converted_arm_reach.py", "out/arm/model.xml")
        table = ("examples/elbow_cohort.csv", "--task", "myoElbowPose1D6MFixed-v0", "--steps", "5")
        run(myowarp, "cohort", *table, "--output", "out/cohort")
        serve(here, myowarp, "view", "--model", "out/arm/model.xml", "--port", "0")
        run(*pip, "uv")
        serve(here, str(bin_ / "uvx"), "--from", f"{wheel}[view]", "myowarp", "demo", "--port", "0")
    print(f"{wheel.name}, {size / 1e6:.1f} MB, works in an empty environment.")


def caches(folder: Path) -> dict[str, str]:
    """Return the environment under which nothing is kept but in a folder."""
    return {"MYOWARP_CACHE_DIR": str(folder / "cache"), "WARP_CACHE_PATH": str(folder / "warp")}


def serve(here: Path, *command: str) -> float:
    """Start a page, fetch it, end it; returns the time from start to page [s]."""
    print("$", *command, flush=True)
    # No cache of an earlier start counts, and no browser opens.
    own = caches(here) | {"DISPLAY": ""}
    begin, address, said = time.monotonic(), "", []
    process = subprocess.Popen(
        command, cwd=here, env=os.environ | own, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        assert process.stderr is not None
        for line in process.stderr:
            said.append(line)
            if found := re.search(r"Open (http://\S+)", line):
                address = found[1]
                break
        assert address, "".join(said)
        took = time.monotonic() - begin
        with urllib.request.urlopen(address, timeout=30) as page:
            assert b"<html" in page.read()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
        process.wait(60)
    return took


if __name__ == "__main__":
    main()
