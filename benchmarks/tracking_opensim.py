"""OpenSim's side of `benchmarks.tracking`: CMC on the files of a folder, which gets a folder `ResultsCMC`.

Needs an interpreter with `opensim` (4.6) only; nothing of ours is imported.
"""

import json
import os
import sys
import time

import opensim


def main():
    """Run CMC with setup.xml."""
    os.chdir(sys.argv[1])
    opensim.Logger.setLevelString("Error")
    tool = opensim.CMCTool("setup.xml")
    before = time.process_time()
    done = tool.run()
    print("RESULT " + json.dumps({"done": done, "seconds": time.process_time() - before,
                                  "version": opensim.GetVersion()}))  # fmt: skip


if __name__ == "__main__":
    main()
