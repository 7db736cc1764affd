#!/usr/bin/env bash
# Guess: a NaN that enters an ONNX graph leaves it as NaN in every runtime, or at least passes activations and bounds as IEEE
# arithmetic and ONNX's own reference have it: tanh(NaN), max(NaN, -1) and min(NaN, 1) are NaN.
#
# Seen instead: in tract, Tanh, Sigmoid, Relu, Min, Max and Clip turn NaN into an ordinary number, an end of their range
# (Tanh: -0.9999994, Sigmoid: 4.5e-07, Relu: 0). Sin, Exp and Erf keep it. ONNX's reference and onnxruntime keep it in all.
#
# Why it matters: a network whose last layer is a Tanh or a Clip, as that of most policies is, answers a state that is not a
# number with full and valid controls. Whoever watches the output for NaN sees nothing: look at the input.
#
# Versions: tract 0.23.9, onnx 1.23.2, onnxruntime 1.32.0, Python 3.11.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet tract==0.23.9 onnx==1.23.2 onnxruntime==1.32.0
venv/bin/python - <<'PYTHON'
import sys

import numpy as np
import onnx
import onnxruntime
import tract
from onnx import TensorProto, helper
from onnx.reference import ReferenceEvaluator

NAN = np.float32([np.nan])
OPERATORS = {"Tanh": [], "Sigmoid": [], "Relu": [], "Min": [1.0], "Max": [-1.0], "Clip": [-1.0, 1.0], "Sin": [], "Erf": []}
KEPT = {"Sin", "Erf"}

print("tract", tract.version(), "onnxruntime", onnxruntime.__version__)
is_as_seen = True
for operator, bounds in OPERATORS.items():
    names = [f"bound{number}" for number in range(len(bounds))]
    constants = [helper.make_tensor(name, TensorProto.FLOAT, [], [bound]) for name, bound in zip(names, bounds)]
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1]) for name in ("x", "y")]
    node = helper.make_node(operator, ["x", *names], ["y"])
    graph = helper.make_graph([node], "one", ends[:1], ends[1:], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 15)], ir_version=8)
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, "one.onnx")
    (reference,) = ReferenceEvaluator(model).run(None, {"x": NAN})
    (runtime,) = onnxruntime.InferenceSession("one.onnx").run(None, {"x": NAN})
    (told,) = tract.onnx().load("one.onnx").into_model().into_runnable().run([NAN])
    (value,) = told.to_numpy()
    print(f"{operator} of NaN: reference {reference[0]}, onnxruntime {runtime[0]}, tract {value}")
    is_as_seen &= bool(np.isnan(reference[0]) and np.isnan(runtime[0]) and np.isnan(value) == (operator in KEPT))
sys.exit(0 if is_as_seen else "This has changed: look at what tract does with NaN now.")
PYTHON
