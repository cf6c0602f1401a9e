"""Trained policies as ONNX and TorchScript: the forward pass of `learned.py`, with the normaliser.

A policy that remembers has what it remembers as second input and output: zeros where an episode begins.

ONNX is written node by node from the arrays, which needs the package onnx alone; TorchScript needs torch.
"""

from __future__ import annotations

import io
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.disk import in_place

OPSET = 17  # of ONNX; 2022, every runtime in use reads it
IR_VERSION = 8  # of the file; the one that came with that opset
OBS, ACTION, MEMORY, NEXT_MEMORY = "obs", "action", "memory", "next_memory"


def write_onnx(checkpoint: Checkpoint, path: Path) -> None:
    """Write the deterministic policy of a checkpoint as an ONNX model.

    Raises:
        OSError: The file cannot be written.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    policy = LearnedPolicy(checkpoint)
    nodes: list[Any] = []
    constants: dict[str, np.ndarray] = {}

    def add(operator: str, inputs: list[str], **attributes: Any) -> str:
        """Append a node; returns the name of its output."""
        nodes.append(helper.make_node(operator, inputs, [f"x{len(nodes)}"], **attributes))
        return f"x{len(nodes) - 1}"

    def constant(name: str, value: Any) -> str:
        """Keep an array of the model; returns its name."""
        constants[name] = np.asarray(value, dtype=np.float32)
        return name

    x = add("Sub", [OBS, constant("mean", policy.mean)])
    x = add("Div", [x, constant("spread", policy.spread)])
    x = add("Clip", [x, constant("low", -policy.clip), constant("high", policy.clip)])
    inputs, outputs = [(OBS, policy.obs_size)], [(ACTION, policy.num_actions)]
    if policy.memory:
        weights = [constant(f"memory{index}", array) for index, array in enumerate(policy.memory)]
        gates = [add("Gemm", [x, *weights[::2]]), add("Gemm", [MEMORY, *weights[1::2]])]
        for part, whole in enumerate(gates):
            names = [f"{gate}{part}" for gate in ("reset", "update", "new")]
            nodes.append(helper.make_node("Split", [whole], names, axis=1))
        reset, update = (add("Sigmoid", [add("Add", [f"{g}0", f"{g}1"])]) for g in ("reset", "update"))
        new = add("Tanh", [add("Add", ["new0", add("Mul", [reset, "new1"])])])
        kept = add("Mul", [update, add("Sub", [MEMORY, new])])
        nodes.append(helper.make_node("Add", [new, kept], [NEXT_MEMORY]))
        x = add("Concat", [x, NEXT_MEMORY], axis=1)
        inputs.append((MEMORY, policy.num_remembered))
        outputs.append((NEXT_MEMORY, policy.num_remembered))
    for index, (weight, bias) in enumerate(policy.layers):
        x = add("Gemm", [x, constant(f"weight{index}", weight), constant(f"bias{index}", bias)])
        if index < len(policy.layers) - 1:
            x = add(policy.activation.capitalize(), [x])
    if len(bias) > policy.num_actions:
        nodes.append(helper.make_node("Split", [x], ["means", "log_std"], axis=1))
        x = "means"
    if policy.squashed:
        x = add("Tanh", [x])
    else:
        x = add("Clip", [x, constant("least", -1.0), constant("most", 1.0)])
    nodes[-1].output[0] = ACTION

    def tensor(name: str, size: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["num_worlds", size])

    graph = helper.make_graph(
        nodes,
        checkpoint.task,
        [tensor(*entry) for entry in inputs],
        [tensor(*entry) for entry in outputs],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    opset = helper.make_opsetid("", OPSET)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=IR_VERSION, producer_name="myowarp")
    helper.set_model_props(model, {"contract": json.dumps(checkpoint.manifest["contract"])})
    onnx.checker.check_model(model, full_check=True)
    with in_place(path) as scratch:
        scratch.write_bytes(model.SerializeToString())


def write_torchscript(checkpoint: Checkpoint, path: Path) -> None:
    """Write the deterministic policy of a checkpoint as TorchScript.

    Raises:
        OSError: The file cannot be written.
    """
    import torch
    from torch import nn

    policy = LearnedPolicy(checkpoint)

    class Module(nn.Module):
        """Observations to actions."""

        mean: torch.Tensor
        spread: torch.Tensor

        def __init__(self) -> None:
            super().__init__()
            self.register_buffer("mean", torch.from_numpy(policy.mean))
            self.register_buffer("spread", torch.from_numpy(policy.spread))
            for index, (weight, bias) in enumerate(policy.layers):
                self.register_buffer(f"weight{index}", torch.from_numpy(weight))
                self.register_buffer(f"bias{index}", torch.from_numpy(bias))
            for index, array in enumerate(policy.memory):
                self.register_buffer(f"memory{index}", torch.from_numpy(array.T.copy()))

        def forward(self, obs: torch.Tensor, memory: torch.Tensor | None = None) -> Any:
            """Return actions (num_worlds, num_actions) for observations (num_worlds, obs_size)."""
            x = ((obs - self.mean) / self.spread).clamp(-policy.clip, policy.clip)
            if memory is not None:
                weights = (getattr(self, f"memory{index}") for index in range(len(policy.memory)))
                memory = torch.gru_cell(x, memory, *weights)
                x = torch.cat((x, memory), dim=1)
            for index in range(len(policy.layers)):
                x = x @ getattr(self, f"weight{index}") + getattr(self, f"bias{index}")
                if index < len(policy.layers) - 1:
                    x = getattr(nn.functional, policy.activation)(x)
            x = x[:, : policy.num_actions]
            action = x.tanh() if policy.squashed else x.clamp(-1.0, 1.0)
            return action if memory is None else (action, memory)

    with torch.no_grad(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "`torch.jit")  # is deprecated, and torch.export needs Python to run
        sizes = policy.obs_size, policy.num_remembered
        script = torch.jit.trace(Module(), tuple(torch.zeros(2, size) for size in sizes if size))
        contract = json.dumps(checkpoint.manifest["contract"])
        content = io.BytesIO()  # a full disk ends the process where torch writes a file itself
        torch.jit.save(script, content, _extra_files={"contract": contract})
    with in_place(path) as scratch:
        scratch.write_bytes(content.getvalue())
