"""Nodes of a cluster are checked, and one that Ray still lists after its death is left out."""

import logging
from pathlib import Path

import pytest

from myowarp.apps.policies.checkpoint import versions
from myowarp.apps.studies import cluster
from myowarp.apps.studies.cluster import each

ray = pytest.importorskip("ray")


@pytest.fixture
def node():
    """Yield the one node of a small cluster."""
    seen = {"env_vars": {"PYTHONPATH": str(Path(__file__).parent)}}  # the functions of this file
    ray.init("local", num_cpus=1, include_dashboard=False, log_to_driver=False, runtime_env=seen)
    yield ray.nodes()[0]
    ray.shutdown()


def broken(here, folder):
    """Do what a node does that lacks a package."""
    raise ModuleNotFoundError("No module named 'warp'")


def double(number):
    """Return twice a number."""
    return 2 * number


@pytest.mark.slow
def test_only_nodes_that_fit_work(node, monkeypatch, tmp_path, caplog):
    """In one test, because a cluster takes seconds to start."""
    dead = node | {"NodeID": "ab" * 28, "NodeManagerAddress": "192.0.2.7"}
    monkeypatch.setattr(ray, "nodes", lambda: [dead, node])  # as Ray lists it for a while
    with caplog.at_level(logging.WARNING, "myowarp"):
        cluster.check_nodes(tmp_path)
    (line,) = caplog.messages
    assert line.startswith("node 192.0.2.7 is gone and left out until it comes back (The task is not sch")
    monkeypatch.setattr(ray, "nodes", lambda: [node])
    address = node["NodeManagerAddress"]
    other = versions() | {"numpy": "1.0"}
    for change, folder, message in (
        (other, tmp_path, f"has numpy {versions()['numpy']}, this machine has 1.0; install"),
        (versions(), tmp_path / "none", f"cannot write '{tmp_path / 'none'}'; every node needs the folder"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(cluster, "versions", lambda change=change: change)
            with pytest.raises(ValueError, match=r"^node") as refused:
                cluster.check_nodes(folder)
            assert message in str(refused.value)
            # A node that came later is asked by each piece of work.
            ((name, result, why),) = each(double, [("a", (4,))], folder=folder, cpus=1)
        assert (name, result, why) == ("a", None, str(refused.value))
        assert address in why
    assert list(each(double, [("a", (4,))], folder=tmp_path, cpus=1)) == [("a", 8, "")]
    monkeypatch.setattr(cluster, "node_misfit", broken)
    with pytest.raises(
        ValueError, match=r"cannot run MyoWarp \(.*No module named 'warp'\); install the same"
    ):
        cluster.check_nodes(tmp_path)
