# pyright: reportMissingImports=false
"""Network policies as ONNX, the form in which runtimes on phones, boards and accelerators take networks."""

from __future__ import annotations

from typing import Any

import numpy as np

from dpend.rig import Rig
from rl.policies import MLPPolicy

from .laws import held_samples

_OPSET, _FORMAT = 17, 8  # of 2022, which runtimes of today all read


def onnx_file(policy: MLPPolicy, rig: Rig, real: str) -> bytes:
    """Return a policy as an ONNX file: from measurements ``y (n, 6)`` to forces ``force (n, 1)``, N, limited.

    Where the policy sees its last action, that is an input too, ``last (n, 1)``, and ``action (n, 1)`` a result.

    Raises
    ------
    ImportError
        If ONNX is not installed.
    """
    try:
        import onnx
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as error:
        raise ImportError("ONNX needs the extra `onnx`: pip install -e '.[onnx]'") from error

    kind, numbers = (TensorProto.DOUBLE, np.float64) if real == "double" else (TensorProto.FLOAT, np.float32)
    network, limit = policy.network, float(rig.force_limit)
    constants: list[Any] = []
    nodes: list[Any] = []

    def constant(name: str, value: Any, dtype: Any = numbers) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value, dtype=dtype), name))
        return name

    def node(operation: str, inputs: list[str], *outputs: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(operation, inputs, list(outputs), **attributes))
        return outputs[0]

    node("Split", ["y", constant("parts", [1, 2, 3], np.int64)], "pos", "angles", "rates", axis=1)
    seen = [
        node("Div", ["pos", constant("pos_scale", policy.scales[:1])], "pos_seen"),
        node("Sin", ["angles"], "sines"),
        node("Cos", ["angles"], "cosines"),
        node("Div", ["rates", constant("rate_scales", policy.scales[1:])], "rates_seen"),
    ]
    order = [0, 1, 3, 2, 4, 5, 6, 7]  # what the network saw alternately stands side by side here
    recalls = network.inputs == 9
    if recalls:
        seen.append("last")
        order.append(8)
    h = node("Concat", seen, "seen", axis=1)
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        weight = weight if k else weight[:, order]
        h = node("Gemm", [h, constant(f"weight{k}", weight), constant(f"bias{k}", bias)], f"sum{k}", transB=1)
        if k < len(network.weights) - 1:
            h = node(network.activation.title(), [h], f"h{k}")
    ends = [constant("least", -1.0), constant("most", 1.0)]
    h = node("Tanh", [h], "action") if network.squash == "tanh" else node("Clip", [h, *ends], "action")
    node("Mul", [h, constant("force_limit", policy.force_limit)], "wanted")
    node("Clip", ["wanted", constant("low", -limit), constant("high", limit)], "force")

    def array(name: str, width: int) -> Any:
        return helper.make_tensor_value_info(name, kind, ["n", width])

    inputs = [array("y", 6), *([array("last", 1)] if recalls else [])]
    outputs = [array("force", 1), *([array("action", 1)] if recalls else [])]
    graph = helper.make_graph(nodes, "policy", inputs, outputs, constants, doc_string=repr(policy))
    model = helper.make_model(graph, producer_name="dpend", opset_imports=[helper.make_opsetid("", _OPSET)])
    model.ir_version = _FORMAT
    helper.set_model_props(model, {"sample_time": repr(float(rig.sample_time)), "hold": str(held_samples(policy, rig))})
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()
