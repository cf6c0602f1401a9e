"""A Ray cluster: started or reached, its nodes checked, and work given to it piece by piece.

Ray starts a piece again where its worker or its node died. The result of a piece is written in one move
(`myowarp.disk.in_place`), so that a piece that was done twice is there once.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from myowarp.apps.policies.checkpoint import versions
from myowarp.disk import sentence
from myowarp.process import CORES, num_cores

logger = logging.getLogger("myowarp")

RETRIES = 10  # of a piece whose worker or node died
PATIENCE = 60.0  # s that a node has to answer
REACH = 5.0  # s that a cluster has to accept a connection
LOOK = 0.5  # s between two looks at what is done


@contextmanager
def connected(address: str | None, folder: Path) -> Iterator[None]:
    """Reach a cluster, or start a local one, and let it go after the block.

    Args:
        address: Host and port of its head, or "auto"; None starts one on this machine.
        folder: Folder that every node must see.

    Raises:
        ValueError: There is no cluster, or a node does not fit.
    """
    import ray

    if address is not None and address != "auto":
        _check_address(address)
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is None:
        options |= {"num_cpus": num_cores(), "include_dashboard": False}
    try:
        ray.init(address or "local", **options)
    except Exception as error:  # Ray raises that very class where a node starts too slowly
        reason = " ".join(str(error).split())
        raise ValueError(f"Ray cluster {address or 'local'!r} cannot be used: {reason}") from error
    try:
        if address is not None:
            check_nodes(folder)
        yield
    finally:
        ray.shutdown()


def _check_address(address: str) -> None:
    """Raise ValueError if nothing listens at an address."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host, int(port)), REACH).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ValueError(
            f"--address {address!r} has no Ray cluster ({error}); start its head with `ray start --head` and "
            "give HOST:6379, or leave it out"
        ) from error


def check_nodes(folder: Path) -> None:
    """Raise ValueError if a node has other versions than this process, or does not see the folder.

    Ray lists a node for a while after it has died. Such a node gets no work; one that comes back, or a new
    one, is checked before each piece of work.
    """
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    nodes = {node["NodeID"]: node["NodeManagerAddress"] for node in _alive()}
    ask = ray.remote(num_cpus=0, max_retries=RETRIES)(node_misfit)
    answers = {
        node: ask.options(scheduling_strategy=NodeAffinitySchedulingStrategy(node, soft=False)).remote(
            versions(), folder
        )
        for node in nodes
    }
    for node, answer in answers.items():
        try:
            misfit = ray.get(answer, timeout=PATIENCE)
        except ray.exceptions.RayError as error:
            reason = str(error).strip().splitlines()[-1]
            lost = isinstance(error, ray.exceptions.TaskUnschedulableError)
            if lost or node not in {other["NodeID"] for other in _alive()}:
                logger.warning("node %s is gone and left out until it comes back (%s)", nodes[node], reason)
                continue
            raise ValueError(
                f"node {nodes[node]} cannot run MyoWarp ({reason}); install the same there"
            ) from error
        if misfit:
            raise ValueError(misfit)


def _alive() -> list[dict[str, Any]]:
    """Return the nodes that Ray takes to be alive."""
    import ray

    return [node for node in ray.nodes() if node["Alive"]]


def node_misfit(here: dict[str, str], folder: Path) -> str:
    """Return in one sentence why a node must not work, "" if it may; it runs on the node.

    Args:
        here: Versions of packages on the machine that gives the work.
        folder: Folder that the node must see.
    """
    import ray

    there, address = versions(), ray.util.get_node_ip_address()
    for name in sorted(here.keys() | there.keys()):
        if here.get(name) != there.get(name):
            return (
                f"node {address} has {name} {there.get(name)}, this machine has {here.get(name)}; "
                "install the same on both"
            )
    if not os.access(folder, os.W_OK):
        return f"node {address} cannot write {str(folder)!r}; every node needs the folder at the same path"
    return ""


def each(
    work: Callable[..., Any],
    pieces: Iterable[tuple[str, tuple[Any, ...]]],
    *,
    folder: Path,
    cpus: int,
    gpus: float = 0.0,
) -> Iterator[tuple[str, Any, str]]:
    """Do pieces of work on a cluster, as many at once as it has room for.

    Args:
        work: Function of a module.
        pieces: Name and arguments of each; few are held at a time.
        folder: Folder that every node must see.
        cpus: Cores that a piece uses.
        gpus: CUDA devices that a piece uses.

    Raises:
        ValueError: No node has so many cores or devices.

    Yields:
        Name, what the work returned, and in one sentence why it failed, "" if it did not; as they end.
    """
    import ray

    nodes = [node["Resources"] for node in _alive()]
    if not any(node.get("CPU", 0) >= cpus and node.get("GPU", 0) >= gpus for node in nodes):
        raise ValueError(f"no node of the cluster has {cpus} cores and {gpus:g} CUDA devices; ask for fewer")
    sent = ray.remote(num_cpus=cpus, num_gpus=gpus, max_retries=RETRIES)(_bounded)
    waiting = iter(pieces)
    pending: dict[Any, str] = {}
    while True:
        room = 2 * max(1, int(ray.cluster_resources().get("CPU", 1)) // cpus)
        while len(pending) < room and (piece := next(waiting, None)) is not None:
            pending[sent.remote(work, cpus, versions(), folder, *piece[1])] = piece[0]
        if not pending:
            return
        for ready in ray.wait(list(pending), timeout=LOOK)[0]:
            name = pending.pop(ready)
            try:
                yield name, ray.get(ready), ""
            except ray.exceptions.RayTaskError as error:
                yield name, None, " ".join(sentence(error.cause or error).split())
            except ray.exceptions.RayError as error:
                yield name, None, f"{type(error).__name__}: {str(error).strip().splitlines()[0]}"


def _bounded(work: Callable[..., Any], cpus: int, here: dict[str, str], folder: Path, *arguments: Any) -> Any:
    """Do a piece of work on no more cores than it has asked for, if the node fits; on a node."""
    if misfit := node_misfit(here, folder):
        raise ValueError(misfit)
    os.environ[CORES] = str(cpus)
    return work(*arguments)
