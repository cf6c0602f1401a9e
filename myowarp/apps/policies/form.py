"""The form of a checkpoint: its manifest, and arrays of a policy whose actions are finite.

Checksums tell damage, not intent: who changes a file can make its checksum anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

ACTIVATIONS = ("elu", "tanh", "relu")  # functions between the layers
MEAN_BOUNDS = ("clip", "tanh")  # what keeps the mean of actions from -1 to 1

MANIFEST_FORM: dict[str, Any] = {
    "format": int,
    "task": str,
    "model": bool,
    "reset": str,
    "conditions": [str],
    "algorithm": str,
    "contract": {
        **{"task": str, "family": str, "body": str, "columns": [(str, int, str)], "actuators": [str]},
        **{"action": str, "reward": [(str, float)], "control_dt": float, "success": str},
    },
    "settings": {
        **{"physics": str, "muscle": str, "reset": str, "conditions": [str]},
        **{"hidden": [int], "activation": str, "seed": int},
    },
    "versions": dict,
    "samples": int,
    "steps": int,
    "updates": int,
    "clock": {"simulation": float, "learner": float, "total": float, "cpu": float},
    "figures": dict,
    "policy": {"activation": str, "clip": float, "epsilon": float, "log_std_bounds": (float, float)},
    "files": dict,
}
"""A type; a list of any length; a tuple of this length; entries by name, others besides.

`int` is a count, `float` a finite number.
"""

FILE_FORM = {"bytes": int, "sha256": str}

OPTIONAL_FORM = {"ranks": int, "parent": dict, "files_read": dict}
"""Entries that may be missing, or none."""

WORDS: dict[type, str] = {
    str: "a text",
    bool: "true or false",
    int: "a count",
    float: "a finite number",
    list: "a list",
    tuple: "a list of {}",
    dict: "entries by name",
}


def check_manifest(manifest: Mapping[str, Any]) -> None:
    """Raise ValueError if a manifest has another form; the reason follows the checkpoint's name."""
    optional = {name: form for name, form in OPTIONAL_FORM.items() if manifest.get(name) is not None}
    misfit = _misfit("", manifest, MANIFEST_FORM | optional)
    misfit = misfit or _misfit("files", manifest["files"], dict.fromkeys(manifest["files"], FILE_FORM))
    if misfit:
        raise ValueError(f"is not what a run writes: {misfit}")
    policy = manifest["policy"]
    for name, names in (("activation", ACTIVATIONS), ("mean_bound", MEAN_BOUNDS)):
        if policy.get(name, names[0]) not in names:
            raise ValueError(
                f"has policy.{name} {policy[name]!r} in its manifest; available: {', '.join(names)}"
            )


def _misfit(name: str, value: Any, form: Any) -> str | None:
    """Return in a few words where a value does not have a form; None: it has it."""
    kind = form if isinstance(form, type) else type(form)
    right = isinstance(value, list if kind is tuple else (int, float) if kind is float else kind)
    if kind in (int, float):
        right = right and not isinstance(value, bool) and math.isfinite(value)
    if kind is int:
        right = right and 0 <= value < 2**63
    if isinstance(form, tuple):
        right = right and len(value) == len(form)
    if not right:
        wanted = WORDS[kind].format(len(form) if isinstance(form, tuple) else "")
        return f"{name} must be {wanted}, got {str(value)[:40]!r}"
    if isinstance(form, dict):
        missing = [f"{name}.{key}".lstrip(".") for key in form if key not in value]
        if missing:
            return f"it has no {missing[0]}"
        parts = [(f"{name}.{key}".lstrip("."), value[key], form[key]) for key in form]
    elif isinstance(form, list | tuple):
        forms = form * len(value) if isinstance(form, list) else form
        parts = [(f"{name}[{i}]", *pair) for i, pair in enumerate(zip(value, forms, strict=True))]
    else:
        return None
    return next((found for part in parts if (found := _misfit(*part)) is not None), None)


def check_policy(manifest: Mapping[str, Any], policy: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError if arrays cannot act as a manifest says; the reason follows the checkpoint's name.

    Args:
        manifest: What `check_manifest` has passed.
        policy: Arrays by name.
    """
    contract, form = manifest["contract"], manifest["policy"]
    inputs, outputs = sum(size for _, size, _ in contract["columns"]), len(contract["actuators"])
    units = policy["memory.bias_ih"].size // 3 if "memory.bias_ih" in policy else 0
    widths = [inputs + units, *manifest["settings"]["hidden"], outputs * (1 if "log_std" in policy else 2)]
    shapes: dict[str, tuple[int, ...]] = {"observation_mean": (inputs,), "observation_variance": (inputs,)}
    if "log_std" in policy:
        shapes["log_std"] = (outputs,)
    if units:
        shapes |= {"memory.weight_ih": (3 * units, inputs), "memory.weight_hh": (3 * units, units)}
        shapes |= {"memory.bias_ih": (3 * units,), "memory.bias_hh": (3 * units,)}
    layers = [(f"net.{2 * i}.weight", f"net.{2 * i}.bias") for i in range(len(widths) - 1)]
    for (weight, bias), width, next_width in zip(layers, widths[:-1], widths[1:], strict=True):
        shapes |= {weight: (next_width, width), bias: (next_width,)}
    for name in shapes.keys() | policy.keys():
        have, need = policy[name].shape if name in policy else "none", shapes.get(name, "none")
        if have != need:
            raise ValueError(f"does not fit its own contract: {name} has shape {have}, {need} is needed")
        if policy[name].dtype.kind != "f":
            raise ValueError(f"has {name} of type {policy[name].dtype}; floating-point numbers are needed")
    with np.errstate(over="ignore", invalid="ignore"):
        numbers = {name: array.astype(np.float32) for name, array in policy.items()}
        for name, array in numbers.items():
            if not np.isfinite(array).all():
                raise ValueError(f"has {name} that is not finite")
        spread = np.sqrt(numbers["observation_variance"]) + np.float32(form["epsilon"])
        if not ((spread > 0.0) & (spread < np.inf)).all():
            raise ValueError("has observation_variance that is no variance")
        # No activation function is farther from 0 than its argument, so that sizes bound all sums. What is
        # remembered lies between -1 and 1, however large the sums of its gates.
        most, gates = np.full(inputs, abs(form["clip"]), np.float32), np.zeros(0, np.float32)
        if units:
            gates = np.abs(numbers["memory.weight_ih"]) @ most + np.abs(numbers["memory.bias_ih"])
            gates += np.abs(numbers["memory.weight_hh"]).sum(axis=1) + np.abs(numbers["memory.bias_hh"])
            most = np.append(most, np.ones(units, np.float32))
        for weight, bias in layers:
            most = np.abs(numbers[weight]) @ most + np.abs(numbers[bias])
        if not np.isfinite([*most, *gates, np.exp(np.float32(form["log_std_bounds"][1]))]).all():
            raise ValueError("has weights so large that actions are not finite")
