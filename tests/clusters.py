"""Clusters of several nodes on this machine, and what can be done to them."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PATIENCE = 1800.0  # s
TRIES = 4
STORE = 80 * 2**20  # bytes of a node's object store, little more than the least
FULL = """
import sys, ray
ray.init(sys.argv[1], log_to_driver=False)
import numpy as np
held = [ray.put(np.ones(2**17)) for _ in range(160)]  # twice what a node's store holds
print("full", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def cluster():
    """Yield a cluster of three nodes; the head does no work."""
    utilities = pytest.importorskip("ray.cluster_utils")
    head = {"num_cpus": 0, "object_store_memory": STORE, "include_dashboard": False}
    cluster = started(lambda: utilities.Cluster(initialize_head=True, head_node_args=head))
    cluster.workers = [add_node(cluster) for _ in range(2)]
    yield cluster
    cluster.shutdown()


def started(start):
    """Return what is started; Ray gives a node 30 s, which busy cores may not be enough for."""
    for _ in range(TRIES - 1):
        try:
            return start()
        except Exception as error:
            if "timed out during startup" not in str(error):
                raise
    return start()


def add_node(cluster):
    """Add a node with one core."""
    return started(lambda: cluster.add_node(num_cpus=1, object_store_memory=STORE))


def replace_node(cluster):
    """Kill a node, and add another."""
    cluster.remove_node(cluster.workers.pop(0), allow_graceful=False)
    cluster.workers.append(add_node(cluster))


def working(cluster):
    """Return the processes that are at work."""
    nodes = cluster.list_all_nodes()
    raylets = {str(info.process.pid) for node in nodes for info in node.all_processes.get("raylet", [])}
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            called = (folder / "cmdline").read_text()
            parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
        except OSError:
            continue
        if parent in raylets and called.startswith("ray::_bounded"):  # others are the node's own agents
            found.append(int(folder.name))
    return found


def kill_worker(cluster):
    """Kill a process that is at work; return whether there was one."""
    for pid in working(cluster):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            os.kill(pid, signal.SIGKILL)
            return True
    return False


def fill_store(cluster):
    """Return a process that has filled the object store, until its input is closed."""
    command = [sys.executable, "-c", FULL, cluster.address]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "full\n"
    return process


def start(*arguments):
    """Start a command in a process of its own."""
    command = [sys.executable, "-m", "myowarp", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_until(done, process):
    """Wait until something is so, while a process runs."""
    begin = time.monotonic()
    while not done():
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() - begin < PATIENCE
        time.sleep(0.1)
