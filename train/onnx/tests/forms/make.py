"""Operator forms and what ONNX Runtime computes for them: writes forms.json beside this file.

    pip install onnx==1.23.2 onnxruntime==1.31.1 numpy
    python train/onnx/tests/forms/make.py

A form is a small graph around one operator. Its input `x` holds multiples of 1/16 between -3.125 and 3.125
(`values`), exact in every float type, so that the file needs no arrays. `runs` says whether the embedded
runtime must compute it as ONNX Runtime does (`y`) or must refuse it with a sentence.
"""

import fnmatch
import itertools
import json
import pathlib
import sys

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper

FORMS = []
TYPES = {
    "f32": TensorProto.FLOAT,
    "f16": TensorProto.FLOAT16,
    "i64": TensorProto.INT64,
    "i32": TensorProto.INT32,
    "bool": TensorProto.BOOL,
    "f64": TensorProto.DOUBLE,
    "u8": TensorProto.UINT8,
    "i8": TensorProto.INT8,
}
NUMPY = {
    "f32": np.float32,
    "f16": np.float16,
    "i64": np.int64,
    "i32": np.int32,
    "bool": np.bool_,
    "f64": np.float64,
    "u8": np.uint8,
    "i8": np.int8,
}
SAMPLE = [1, 2, 4, 5]


def values(shape, start=0):
    """Multiples of 1/16, in an order without a pattern."""
    count = int(np.prod(shape, dtype=np.int64))
    return (
        np.array([((start + i) * 37 + 11) % 101 - 50 for i in range(count)], np.float32).reshape(shape) / 16
    )


def c(data, kind="f32"):
    """A constant given by its elements."""
    data = np.array(data)
    items = data.flatten().tolist()
    whole = kind not in ("f32", "f16", "f64")
    items = [int(v) if whole else float(v) if np.isfinite(v) else str(v) for v in items]
    return {"type": kind, "shape": list(data.shape), "data": items}


def i64(*data):
    return c(np.array(data, np.int64), "i64")


def w(*shape, start=7):
    """A constant filled by `values`."""
    return {"type": "f32", "shape": list(shape), "start": start}


class N:
    """A node; inputs are names, constants or None."""

    def __init__(self, op, *inputs, outputs=1, domain="", **attributes):
        self.op, self.inputs, self.outputs, self.domain, self.attributes = (
            op,
            inputs,
            outputs,
            domain,
            attributes,
        )


def form(name, nodes, x=SAMPLE, opsets=(17,), take=0, cast=False):
    """`take` is the output of the last node that is compared; `cast` makes it f32 first."""
    nodes = nodes if isinstance(nodes, list) else [nodes]
    FORMS.append(dict(name=name, nodes=nodes, x=list(x), opsets=list(opsets), take=take, cast=cast))


def described(f):
    """The form as it stands in the file: nodes with named values, constants apart."""
    constants, nodes, previous = {}, [], "x"
    for number, node in enumerate(f["nodes"]):
        inputs = []
        for place, value in enumerate(node.inputs):
            if value is None:
                inputs.append("")
            elif isinstance(value, str):
                inputs.append(value)
            else:
                name = f"c{number}_{place}"
                constants[name] = value
                inputs.append(name)
        outputs = [f"v{number}_{k}" for k in range(node.outputs)]
        nodes.append(
            {
                "op": node.op,
                "domain": node.domain,
                "inputs": inputs,
                "outputs": outputs,
                "attributes": node.attributes,
            }
        )
    result = nodes[-1]["outputs"][f["take"]]
    if f["cast"]:
        nodes.append(
            {"op": "Cast", "domain": "", "inputs": [result], "outputs": ["y"], "attributes": {"to": 1}}
        )
    else:
        nodes[-1]["outputs"][f["take"]] = "y"
    return {"name": f["name"], "opsets": f["opsets"], "x": f["x"], "constants": constants, "nodes": nodes}


def model(d, opset):
    nodes = []
    for number, node in enumerate(d["nodes"]):
        attributes = {}
        for key, value in node["attributes"].items():
            if isinstance(value, dict):
                value = onnx.numpy_helper.from_array(
                    np.array(value["data"], NUMPY[value["type"]]).reshape(value["shape"])
                )
            attributes[key] = value
        nodes.append(
            helper.make_node(
                node["op"],
                node["inputs"],
                node["outputs"],
                name=f"n{number}",
                domain=node["domain"],
                **attributes,
            )
        )
    initializers = []
    for name, value in d["constants"].items():
        kind = NUMPY[value["type"]]
        data = (
            values(value["shape"], value["start"])
            if "start" in value
            else np.array([kind(v) for v in value["data"]], kind)
        )
        initializers.append(onnx.numpy_helper.from_array(data.astype(kind).reshape(value["shape"]), name))
    graph = helper.make_graph(
        nodes,
        "form",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, d["x"])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, None)],
        initializers,
    )
    imports = [helper.make_opsetid("", opset)]
    if any(node["domain"] for node in d["nodes"]):
        imports.append(helper.make_opsetid("com.microsoft", 1))
    return helper.make_model(graph, opset_imports=imports, ir_version=8)


def run(d, opset):
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(
        model(d, opset).SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    return session.run(["y"], {"x": values(d["x"])})[0]


A = "x"
# --- elementwise, one input
for op in [
    "Relu",
    "Sigmoid",
    "Tanh",
    "Exp",
    "Abs",
    "Neg",
    "Floor",
    "Ceil",
    "Sin",
    "Cos",
    "Erf",
    "Softplus",
    "Softsign",
    "Identity",
    "Sign",
    "Round",
    "Reciprocal",
    "Tan",
    "Atan",
    "Sinh",
    "Cosh",
    "Asinh",
]:
    lo = {"Erf": 9, "Sign": 9, "Sinh": 9, "Cosh": 9, "Asinh": 9, "Round": 11}.get(op, 7)
    form(op, N(op, A), opsets=[o for o in (7, 9, 11, 13, 17, 21) if o >= lo])
form("Round/halves", [N("Mul", A, c(8.0)), N("Round", "v0_0")], opsets=(11, 17))
for op in ["Sqrt", "Log"]:
    form(op, [N("Abs", A), N("Add", "v0_0", c(0.5)), N(op, "v1_0")], opsets=(7, 13, 17))
form("Sqrt/negative", N("Sqrt", A))
form("Log/negative", N("Log", A))
for op in ["Acos", "Asin", "Atanh"]:
    form(op, [N("Mul", A, c(0.25)), N(op, "v0_0")], opsets=(9, 17))
form("Acosh", [N("Abs", A), N("Add", "v0_0", c(1.0)), N("Acosh", "v1_0")], opsets=(9, 17))
form("Elu", N("Elu", A), opsets=(7, 17))
form("Elu/alpha", N("Elu", A, alpha=0.5))
form("LeakyRelu", N("LeakyRelu", A), opsets=(7, 16))
form("LeakyRelu/alpha", N("LeakyRelu", A, alpha=0.2))
form("HardSigmoid", N("HardSigmoid", A), opsets=(7, 17))
form("HardSigmoid/both", N("HardSigmoid", A, alpha=0.25, beta=0.4))
form("HardSwish", N("HardSwish", A), opsets=(14, 17))
form("Mish", N("Mish", A), opsets=(18,))
form("Celu", N("Celu", A), opsets=(12, 17))
form("Selu", N("Selu", A), opsets=(7, 17))
form("ThresholdedRelu", N("ThresholdedRelu", A), opsets=(10, 17))
form("Shrink", N("Shrink", A), opsets=(9, 17))
form("Hardmax", N("Hardmax", A), opsets=(13,))
form("Gelu", N("Gelu", A), opsets=(20, 21))
form("Gelu/tanh", N("Gelu", A, approximate="tanh"), opsets=(20,))
form("PRelu/channels", N("PRelu", A, c([[[0.1]], [[0.3]]])), opsets=(7, 9, 16, 17))
form("PRelu/one", N("PRelu", A, c([0.25])), opsets=(9, 16))
form("PRelu/all", N("PRelu", A, w(2, 4, 5)), opsets=(16,))
form("Clip/attributes", N("Clip", A, min=-1.0, max=1.5), opsets=(7, 10))
form("Clip/no attributes", N("Clip", A), opsets=(7, 10))
form("Clip/inputs", N("Clip", A, c(-1.0), c(1.5)), opsets=(11, 12, 13, 17))
form("Clip/min", N("Clip", A, c(0.0)), opsets=(11, 13))
form("Clip/max", N("Clip", A, None, c(1.0)), opsets=(11, 13))
form("Clip/crossed", N("Clip", A, c(1.5), c(-1.0)), opsets=(13,))
form("Dropout/inference", N("Dropout", A), opsets=(7, 10, 12, 13))
form("Dropout/ratio", N("Dropout", A, c(0.5)), opsets=(12, 13))
# --- elementwise, several inputs
for op in ["Add", "Sub", "Mul", "Div", "Max", "Min", "Sum", "Mean", "Pow"]:
    other = w(*SAMPLE, start=40)
    first = A
    pre = []
    if op == "Pow":
        pre, first, other = [N("Abs", A)], "v0_0", c(1.5)
    lo = {"Max": 8, "Min": 8, "Sum": 8, "Mean": 8}.get(op, 7)
    if op == "Div":
        other = c(0.375)
    form(op, pre + [N(op, first, other)], opsets=[o for o in (7, 8, 11, 13, 17) if o >= lo])
    if op not in ("Pow", "Div"):
        form(op + "/row", N(op, A, w(5)), opsets=(8, 17))
        form(op + "/column", N(op, w(4, 1), A))
        form(op + "/more dims", N(op, A, w(3, 1, 2, 4, 5)))
form("Pow/square", N("Pow", A, c(2.0)), opsets=(7, 12, 13, 17))
form("Pow/negative base, whole exponent", N("Pow", A, c(3.0)))
form("Pow/half", N("Pow", A, c(0.5)))
form("Pow/int exponent", N("Pow", A, i64(2)), opsets=(12, 13, 15))
form("Pow/int32 exponent", N("Pow", A, c([3], "i32")), opsets=(12, 15))
form("Div/zero", N("Div", A, c(0.0)))
form("Max/three", N("Max", A, c(0.5), w(5)), opsets=(8, 13))
form("Max/one", N("Max", A), opsets=(8, 13))
form("Sum/three", N("Sum", A, c(0.5), w(5)), opsets=(8, 13))
form("Mean/three", N("Mean", A, c(0.5), w(5)), opsets=(8, 13))
form("Mod/fmod", N("Mod", A, c(0.75), fmod=1), opsets=(10, 13))
form("Mod/int", [N("Cast", A, to=7), N("Mod", "v0_0", i64(2))], opsets=(10, 13), cast=True)
form("Mod/int negative", [N("Cast", A, to=7), N("Mod", "v0_0", i64(-2))], opsets=(13,), cast=True)
form("Mod/int fmod", [N("Cast", A, to=7), N("Mod", "v0_0", i64(2), fmod=1)], opsets=(13,), cast=True)
for op in ["Add", "Sub", "Mul", "Div", "Max", "Min", "Pow"]:
    lo = {"Max": 12, "Min": 12, "Pow": 12}.get(op, 7)
    data = i64(2) if op == "Pow" else i64(3)
    form(
        op + "/i64",
        [N("Cast", A, to=7), N(op, "v0_0", data)],
        opsets=[o for o in (7, 13, 17) if o >= lo],
        cast=True,
    )
    form(
        op + "/i32",
        [N("Cast", A, to=6), N(op, "v0_0", c([3], "i32"))],
        opsets=[o for o in (13, 17) if o >= lo],
        cast=True,
    )
form("Div/i64 negative divisor", [N("Cast", A, to=7), N("Div", "v0_0", i64(-2))], cast=True)
form("Neg/i64", [N("Cast", A, to=7), N("Neg", "v0_0")], cast=True)
form("Abs/i64", [N("Cast", A, to=7), N("Abs", "v0_0")], cast=True)
form("Sign/i64", [N("Cast", A, to=7), N("Sign", "v0_0")], cast=True)
form("Mul/i64 beyond 32 bits", [N("Cast", A, to=7), N("Mul", "v0_0", i64(3000000000))], cast=True)
form("Not", [pos, N("Not", "v0_0")], opsets=(9, 17), cast=True)
for op in ["And", "Or", "Xor"]:
    form(op, [pos, N("Less", A, c(1.0)), N(op, "v0_0", "v1_0")], opsets=(9, 17), cast=True)
form("Equal/bool", [pos, N("Less", A, c(1.0)), N("Equal", "v0_0", "v1_0")], opsets=(13,), cast=True)
form("Where", [pos, N("Where", "v0_0", A, c(-7.0))], opsets=(9, 16, 17))
form("Where/broadcast", [N("Greater", w(5), c(0.0)), N("Where", "v0_0", A, w(4, 1))])
form("Where/i64", [pos, N("Where", "v0_0", i64(3), i64(4))], cast=True)
form("IsNaN", [N("Log", A), N("IsNaN", "v0_0")], opsets=(9, 13), cast=True)
form("IsInf", [N("Div", A, c(0.0)), N("IsInf", "v0_0")], opsets=(10,), cast=True)
form("IsInf/positive", [N("Div", A, c(0.0)), N("IsInf", "v0_0", detect_negative=0)], opsets=(10,), cast=True)
for op in ["BitwiseAnd", "BitwiseOr"]:
    form(op, [N("Cast", A, to=7), N(op, "v0_0", i64(3))], opsets=(18,), cast=True)
# --- casts
for name, to in [
    ("f32", 1),
    ("i64", 7),
    ("i32", 6),
    ("bool", 9),
    ("f16", 10),
    ("f64", 11),
    ("u8", 2),
    ("i8", 3),
    ("i16", 5),
    ("bf16", 16),
    ("u32", 12),
]:
    form("Cast/" + name, N("Cast", A, to=to), opsets=(9, 13, 19), cast=True)
form("Cast/bool then mask", [N("Cast", A, to=9), N("Where", "v0_0", c(1.0), c(0.0))])
form("Cast/i64 then bool", [N("Cast", A, to=7), N("Cast", "v0_0", to=9)], cast=True)
form("Cast/from bool", [pos, N("Cast", "v0_0", to=7)], cast=True)
form("Cast/f16 constant", [N("Cast", c([0.5, -1.25, 3.0, 1.0, 2.0], "f16"), to=1), N("Add", A, "v0_0")])
form("Cast/f64 constant", [N("Cast", c([0.1], "f64"), to=1), N("Add", A, "v0_0")])
form("CastLike", N("CastLike", A, i64(1)), opsets=(15, 19), cast=True)
# --- convolution
W = w(3, 2, 3, 3)
B = w(3)
for name, at in {
    "": {},
    "pads": dict(pads=[1, 1, 1, 1]),
    "uneven pads": dict(pads=[0, 1, 2, 1]),
    "strides": dict(strides=[2, 1], pads=[1, 1, 1, 1]),
    "dilations": dict(dilations=[1, 2], pads=[1, 2, 1, 2]),
    "same upper": dict(auto_pad="SAME_UPPER", strides=[2, 2]),
    "same lower": dict(auto_pad="SAME_LOWER", strides=[2, 2]),
    "same lower, odd": dict(auto_pad="SAME_LOWER"),
    "valid": dict(auto_pad="VALID"),
    "notset": dict(auto_pad="NOTSET", pads=[1, 1, 1, 1]),
    "same upper, dilations": dict(auto_pad="SAME_UPPER", dilations=[1, 2]),
}.items():
    form(
        f"Conv/{name}",
        N("Conv", A, W, B, kernel_shape=[3, 3], **at),
        opsets=(7, 11, 17) if not name else (17,),
    )
    form(f"Conv/{name}, no kernel_shape", N("Conv", A, W, B, **at))
form("Conv/even kernel, same upper", N("Conv", A, w(3, 2, 2, 2), kernel_shape=[2, 2], auto_pad="SAME_UPPER"))
form("Conv/even kernel, same lower", N("Conv", A, w(3, 2, 2, 2), kernel_shape=[2, 2], auto_pad="SAME_LOWER"))
form("Conv/no bias", N("Conv", A, W, kernel_shape=[3, 3]))
form("Conv/1x1", N("Conv", A, w(4, 2, 1, 1), kernel_shape=[1, 1]))
form("Conv/1x1 strided", N("Conv", A, w(4, 2, 1, 1), kernel_shape=[1, 1], strides=[2, 2]))
form("Conv/depthwise", N("Conv", A, w(2, 1, 3, 3), w(2), kernel_shape=[3, 3], group=2, pads=[1, 1, 1, 1]))
form("Conv/groups", N("Conv", A, w(4, 2, 3, 3), kernel_shape=[3, 3], group=2), x=[1, 4, 5, 5])
form(
    "Conv/depthwise multiplied", N("Conv", A, w(4, 1, 3, 3), kernel_shape=[3, 3], group=2, pads=[1, 1, 1, 1])
)
form(
    "Conv/depthwise dilated",
    N("Conv", A, w(2, 1, 3, 3), kernel_shape=[3, 3], group=2, pads=[2, 2, 2, 2], dilations=[2, 2]),
)
form("Conv/one dimension", N("Conv", A, w(3, 2, 3), kernel_shape=[3], pads=[1, 1]), x=[1, 2, 6])
form("Conv/three dimensions", N("Conv", A, w(3, 2, 2, 2, 2), kernel_shape=[2, 2, 2]), x=[1, 2, 3, 3, 3])
form("Conv/two images", N("Conv", A, W, B, kernel_shape=[3, 3], pads=[1, 1, 1, 1]), x=[2, 2, 4, 5])
T = w(2, 3, 4, 4)
for name, at in {
    "": {},
    "stride 2": dict(strides=[2, 2]),
    "stride 2, pads": dict(strides=[2, 2], pads=[1, 1, 1, 1]),
    "output_padding": dict(strides=[2, 2], pads=[1, 1, 1, 1], output_padding=[1, 1]),
    "output_shape": dict(strides=[2, 2], output_shape=[8, 10]),
    "same upper": dict(strides=[2, 2], auto_pad="SAME_UPPER"),
    "same lower": dict(strides=[2, 2], auto_pad="SAME_LOWER"),
    "dilations": dict(dilations=[2, 1]),
    "uneven pads": dict(strides=[2, 2], pads=[0, 1, 2, 1]),
    "valid": dict(strides=[2, 2], auto_pad="VALID"),
}.items():
    form(
        f"ConvTranspose/{name}",
        N("ConvTranspose", A, T, w(3), kernel_shape=[4, 4], **at),
        opsets=(7, 11, 17) if not name else (17,),
    )
form("ConvTranspose/no kernel_shape", N("ConvTranspose", A, T, strides=[2, 2], pads=[1, 1, 1, 1]))
form(
    "ConvTranspose/groups",
    N("ConvTranspose", A, w(4, 2, 2, 2), kernel_shape=[2, 2], strides=[2, 2], group=2),
    x=[1, 4, 3, 3],
)
form(
    "ConvTranspose/one dimension",
    N("ConvTranspose", A, w(2, 3, 4), kernel_shape=[4], strides=[2], pads=[1, 1]),
    x=[1, 2, 6],
)
form(
    "ConvTranspose/same upper, kernel 3",
    N("ConvTranspose", A, w(2, 3, 3, 3), kernel_shape=[3, 3], strides=[2, 2], auto_pad="SAME_UPPER"),
)
# --- pools
for op in ["MaxPool", "AveragePool"]:
    ops = (7, 8, 10, 11, 12, 17) if op == "MaxPool" else (7, 10, 11, 17, 19)
    for name, at in {
        "2x2": dict(kernel_shape=[2, 2], strides=[2, 2]),
        "no strides": dict(kernel_shape=[2, 2]),
        "pads": dict(kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1]),
        "uneven pads": dict(kernel_shape=[3, 3], strides=[1, 1], pads=[0, 1, 1, 0]),
        "same upper": dict(kernel_shape=[2, 2], strides=[2, 2], auto_pad="SAME_UPPER"),
        "same lower": dict(kernel_shape=[2, 2], strides=[2, 2], auto_pad="SAME_LOWER"),
        "valid": dict(kernel_shape=[2, 2], strides=[2, 2], auto_pad="VALID"),
        "3x2": dict(kernel_shape=[3, 2], strides=[1, 2]),
    }.items():
        form(f"{op}/{name}", N(op, A, **at), opsets=ops if name == "2x2" else (11, 17))
    for name, at in {
        "ceil": dict(kernel_shape=[2, 2], strides=[2, 2], ceil_mode=1),
        "ceil, pads": dict(kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1], ceil_mode=1),
        "ceil, window outside": dict(kernel_shape=[2, 2], strides=[3, 3], pads=[0, 0, 1, 1], ceil_mode=1),
        "ceil, kernel 3": dict(kernel_shape=[3, 3], strides=[2, 2], ceil_mode=1),
    }.items():
        form(f"{op}/{name}", N(op, A, **at), opsets=(10, 17, 19) if op == "AveragePool" else (10, 17))
    form(f"{op}/one dimension", N(op, A, kernel_shape=[2], strides=[2]), x=[1, 2, 6])
    form(f"{op}/three dimensions", N(op, A, kernel_shape=[2, 2, 2], strides=[1, 1, 1]), x=[1, 2, 3, 3, 3])
    form(
        f"{op}/dilations",
        N(op, A, kernel_shape=[2, 2], strides=[1, 1], dilations=[2, 2]),
        opsets=(10, 17) if op == "MaxPool" else (19,),
    )
    form(
        f"{op}/dilations of one",
        N(op, A, kernel_shape=[2, 2], strides=[1, 1], dilations=[1, 1]),
        opsets=(10, 17) if op == "MaxPool" else (19,),
    )
for pads in [[1, 1, 1, 1], [0, 1, 1, 0]]:
    for ceil in (0, 1):
        form(
            f"AveragePool/count_include_pad {pads} ceil {ceil}",
            N(
                "AveragePool",
                A,
                kernel_shape=[3, 3],
                strides=[2, 2],
                pads=pads,
                ceil_mode=ceil,
                count_include_pad=1,
            ),
            opsets=(10, 11, 17, 19),
        )
form(
    "AveragePool/count_include_pad same upper",
    N("AveragePool", A, kernel_shape=[2, 2], strides=[2, 2], auto_pad="SAME_UPPER", count_include_pad=1),
    opsets=(11, 19),
)
form(
    "MaxPool/storage_order",
    N("MaxPool", A, kernel_shape=[2, 2], strides=[1, 1], storage_order=1),
    opsets=(17,),
)
form("MaxPool/indices", N("MaxPool", A, kernel_shape=[2, 2], strides=[1, 1], outputs=2), opsets=(17,))
form("GlobalAveragePool", N("GlobalAveragePool", A), opsets=(7, 17))
form("GlobalMaxPool", N("GlobalMaxPool", A), opsets=(7, 17))
form("GlobalAveragePool/one dimension", N("GlobalAveragePool", A), x=[1, 2, 6])
form("GlobalMaxPool/one dimension", N("GlobalMaxPool", A), x=[1, 2, 6])
form("LpPool", N("LpPool", A, kernel_shape=[2, 2]), opsets=(11,))
# --- normalisation
form(
    "BatchNormalization",
    N("BatchNormalization", A, w(2), w(2, start=9), w(2, start=1), c([0.5, 2.0])),
    opsets=(7, 9, 14, 15, 17),
)
form(
    "BatchNormalization/epsilon",
    N("BatchNormalization", A, w(2), w(2, start=9), w(2, start=1), c([0.5, 2.0]), epsilon=0.1, momentum=0.8),
)
form(
    "BatchNormalization/training",
    N("BatchNormalization", A, w(2), w(2, start=9), w(2, start=1), c([0.5, 2.0]), training_mode=1, outputs=3),
    opsets=(15,),
)
form(
    "BatchNormalization/two dimensions",
    N("BatchNormalization", A, w(5), w(5, start=9), w(5, start=1), c([0.5, 2.0, 1.0, 1.5, 3.0])),
    x=[4, 5],
)
form("InstanceNormalization", N("InstanceNormalization", A, w(2), w(2, start=9)), opsets=(7, 17))
form("InstanceNormalization/epsilon", N("InstanceNormalization", A, w(2), w(2, start=9), epsilon=0.1))
form("InstanceNormalization/one dimension", N("InstanceNormalization", A, w(2), w(2, start=9)), x=[1, 2, 6])
form("LayerNormalization", N("LayerNormalization", A, w(5), w(5, start=9)), opsets=(17, 21))
form("LayerNormalization/no bias", N("LayerNormalization", A, w(5)))
form("LayerNormalization/axis 2", N("LayerNormalization", A, w(4, 5), w(4, 5, start=9), axis=2))
form("LayerNormalization/axis -2", N("LayerNormalization", A, w(4, 5), axis=-2, epsilon=0.01))
form("LayerNormalization/broadcast scale", N("LayerNormalization", A, w(1), axis=-1))
form("LayerNormalization/mean", N("LayerNormalization", A, w(5), outputs=2), take=1)
form("GroupNormalization", N("GroupNormalization", A, w(2), w(2), num_groups=2), opsets=(21,), x=SAMPLE)
form("LpNormalization", N("LpNormalization", A), opsets=(9, 17))
form("LpNormalization/p 1, axis 1", N("LpNormalization", A, p=1, axis=1))
form("LRN", N("LRN", A, size=3), opsets=(13,))
form("MeanVarianceNormalization", N("MeanVarianceNormalization", A), opsets=(13,))
# --- softmax
for op in ["Softmax", "LogSoftmax"]:
    form(op, N(op, A), opsets=(7, 11, 12, 13, 17))
    for axis in (-1, 0, 1, 2, 3, -2):
        form(
            f"{op}/axis {axis}",
            N(op, A, axis=axis),
            opsets=(7, 11, 12, 13, 17) if axis >= 0 else (11, 12, 13, 17),
        )
    form(f"{op}/two dimensions", N(op, A), x=[4, 5], opsets=(11, 13))
    form(f"{op}/axis 1 of two", N(op, A, axis=1), x=[4, 5], opsets=(11, 13))
# --- matrices
form("MatMul", N("MatMul", A, w(5, 3)), opsets=(7, 9, 13))
form("MatMul/left", N("MatMul", w(3, 4), A))
form("MatMul/batched", N("MatMul", A, w(1, 2, 5, 3)))
form("MatMul/broadcast", N("MatMul", A, w(2, 1, 1, 5, 3)))
form("MatMul/vector", N("MatMul", A, w(5)))
form("MatMul/two", [N("Transpose", A, perm=[0, 1, 3, 2]), N("MatMul", A, "v0_0")])
for ta, tb in itertools.product((0, 1), (0, 1)):
    form(
        f"Gemm/transA {ta} transB {tb}",
        N(
            "Gemm",
            A,
            w(*((3, 5) if tb else (5, 3))) if not ta else w(*((3, 4) if tb else (4, 3))),
            w(3),
            transA=ta,
            transB=tb,
            alpha=0.5,
            beta=2.0,
        ),
        x=[4, 5],
        opsets=(7, 11, 13),
    )
form("Gemm/no C", N("Gemm", A, w(5, 3)), x=[4, 5], opsets=(11, 13))
form("Gemm/matrix C", N("Gemm", A, w(5, 3), w(4, 3)), x=[4, 5])
form("Gemm/column C", N("Gemm", A, w(5, 3), w(4, 1)), x=[4, 5])
form("Gemm/scalar C", N("Gemm", A, w(5, 3), c(0.5)), x=[4, 5])
form("Gemm/beta 0", N("Gemm", A, w(5, 3), w(3), beta=0.0), x=[4, 5])
for eq, other in [
    ("bchw,hd->bcdw", w(4, 3)),
    ("bchw,bchv->bcwv", w(1, 2, 4, 3)),
    ("bchw->bhwc", None),
    ("bchw->bc", None),
    ("bcii->bci", None),
    ("...hw,wv->...hv", w(5, 2)),
    ("bchw,bchw->b", w(*SAMPLE)),
]:
    if eq == "bcii->bci":
        form(f"Einsum/{eq}", N("Einsum", A, equation=eq), opsets=(12,), x=[1, 2, 4, 4])
    else:
        form(f"Einsum/{eq}", N("Einsum", A, *([other] if other else []), equation=eq), opsets=(12, 17))
# --- layout
form("Transpose", N("Transpose", A), opsets=(7, 13, 17))
form("Transpose/perm", N("Transpose", A, perm=[0, 2, 3, 1]), opsets=(7, 17))
form("Transpose/i64", [N("Cast", A, to=7), N("Transpose", "v0_0")], cast=True)
form("Reshape", N("Reshape", A, i64(2, 20)), opsets=(7, 13, 14, 17))
form("Reshape/minus one", N("Reshape", A, i64(4, -1)))
form("Reshape/zero", N("Reshape", A, i64(0, 2, -1)), opsets=(7, 17))
form("Reshape/allowzero", N("Reshape", A, i64(4, 10), allowzero=1), opsets=(14,))
form("Reshape/allowzero with zero", N("Reshape", A, i64(0, 2, -1), allowzero=0), opsets=(14,))
for axis in (0, 1, 2, -1):
    form(f"Flatten/axis {axis}", N("Flatten", A, axis=axis), opsets=(9, 11, 13) if axis >= 0 else (11, 13))
form("Flatten", N("Flatten", A), opsets=(7, 9, 13))
form("Squeeze/attribute", N("Squeeze", A, axes=[0]), opsets=(7, 11))
form("Squeeze/input", N("Squeeze", A, i64(0)), opsets=(13, 17))
form("Squeeze/all", N("Squeeze", A), opsets=(7, 13))
form("Squeeze/negative", N("Squeeze", A, i64(-4)), opsets=(13,))
form("Unsqueeze/attribute", N("Unsqueeze", A, axes=[0, 3]), opsets=(7, 11))
form("Unsqueeze/input", N("Unsqueeze", A, i64(0, 3)), opsets=(13, 17))
form("Unsqueeze/negative", N("Unsqueeze", A, i64(-1)), opsets=(13,))
form("Unsqueeze/unsorted", N("Unsqueeze", A, i64(3, 0)), opsets=(13,))
for axis in (0, 1, 3, -1):
    form(
        f"Concat/axis {axis}",
        N("Concat", A, w(*SAMPLE, start=50), axis=axis),
        opsets=(7, 11, 13) if axis >= 0 else (11, 13),
    )
form("Concat/three", N("Concat", A, A, w(1, 3, 4, 5), axis=1))
form("Concat/one", N("Concat", A, axis=1))
form("Concat/i64", [N("Cast", A, to=7), N("Concat", "v0_0", "v0_0", axis=1)], cast=True)
form("Slice/attributes", N("Slice", A, starts=[1, 0], ends=[3, 100], axes=[2, 3]), opsets=(7, 9))
form("Slice/attributes without axes", N("Slice", A, starts=[0, 1], ends=[1, 2]), opsets=(7, 9))
form("Slice/inputs", N("Slice", A, i64(1), i64(3), i64(2)), opsets=(10, 11, 13))
form("Slice/steps", N("Slice", A, i64(0, 4), i64(4, -6), i64(2, 3), i64(2, -1)), opsets=(10, 13))
form("Slice/negative", N("Slice", A, i64(-3), i64(-1), i64(-1)))
form("Slice/to the end", N("Slice", A, i64(1), i64(9223372036854775807), i64(3)))
form(
    "Slice/from the end", N("Slice", A, i64(9223372036854775807), i64(-9223372036854775808), i64(3), i64(-1))
)
form("Slice/no axes", N("Slice", A, i64(0, 1), i64(1, 2)))
form("Slice/no axes, steps", N("Slice", A, i64(0, 1, 0, 0), i64(1, 2, 4, 5), None, i64(1, 1, 2, 2)))
form("Slice/i32 indices", N("Slice", A, c([1], "i32"), c([3], "i32"), c([2], "i32")))
form("Split/attribute", N("Split", A, axis=3, split=[2, 3], outputs=2), opsets=(7, 11), take=1)
form("Split/input", N("Split", A, i64(2, 3), axis=3, outputs=2), opsets=(13, 17), take=1)
form("Split/even", N("Split", A, axis=2, outputs=2), opsets=(7, 11, 13, 17), take=1)
form("Split/num_outputs", N("Split", A, axis=2, num_outputs=2, outputs=2), opsets=(18,), take=1)
form("Split/num_outputs uneven", N("Split", A, axis=3, num_outputs=2, outputs=2), opsets=(18,), take=1)
form("Split/negative axis", N("Split", A, axis=-2, outputs=2), opsets=(11, 13), take=0)
form("Gather", N("Gather", A, i64(1, 0), axis=1), opsets=(7, 11, 13))
form("Gather/scalar", N("Gather", A, c(2, "i64"), axis=2))
form("Gather/negative", N("Gather", A, i64(-1, 0), axis=3), opsets=(11, 13))
form("Gather/negative axis", N("Gather", A, i64(1), axis=-1), opsets=(11,))
form("Gather/default axis", N("Gather", A, i64(0)))
form("Gather/2d indices", N("Gather", A, c([[0, 1], [2, 3]], "i64"), axis=2))
form("Gather/i32 indices", N("Gather", A, c([1], "i32"), axis=1))
form(
    "GatherElements",
    N("GatherElements", A, c(np.array([[[[0, 1, 2], [2, 1, 0]]]]), "i64"), axis=3),
    opsets=(11, 13),
)
form("GatherND", N("GatherND", A, c([[0, 1], [0, 0]], "i64")), opsets=(11, 13))
form("GatherND/batch_dims", N("GatherND", A, c([[0, 1]], "i64"), batch_dims=1), opsets=(12, 13))
form("ScatterND", N("ScatterND", A, c([[0, 1, 2, 3]], "i64"), c([9.0])), opsets=(11, 13, 16))
form(
    "ScatterND/add",
    N("ScatterND", A, c([[0, 1, 2, 3], [0, 1, 2, 3]], "i64"), c([9.0, 1.0]), reduction="add"),
    opsets=(16, 18),
)
form("ScatterND/mul", N("ScatterND", A, c([[0, 1, 2, 3]], "i64"), c([9.0]), reduction="mul"), opsets=(16,))
form("ScatterND/max", N("ScatterND", A, c([[0, 1, 2, 3]], "i64"), c([9.0]), reduction="max"), opsets=(18,))
form(
    "ScatterElements",
    N("ScatterElements", A, c([[[[1]]]], "i64"), c([[[[9.0]]]]), axis=3),
    opsets=(11, 13, 16),
)
form(
    "ScatterElements/add",
    N("ScatterElements", A, c([[[[1]]]], "i64"), c([[[[9.0]]]]), axis=3, reduction="add"),
    opsets=(16, 18),
)
form("Tile", N("Tile", A, i64(1, 2, 1, 3)), opsets=(7, 13))
form("Expand", N("Expand", A, i64(3, 2, 4, 5)), opsets=(8, 13))
form("Expand/more dims", N("Expand", A, i64(2, 1, 1, 1, 1)))
form("Expand/ones", N("Expand", A, i64(1, 1)))
form("Pad/attributes", N("Pad", A, mode="constant", pads=[0, 0, 1, 2, 0, 0, 3, 1], value=0.5), opsets=(7, 10))
form("Pad/inputs", N("Pad", A, i64(0, 0, 1, 2, 0, 0, 3, 1), c(0.5)), opsets=(11, 13, 17, 19))
form("Pad/no value", N("Pad", A, i64(0, 0, 1, 2, 0, 0, 3, 1)), opsets=(11, 13))
for mode in ("reflect", "edge"):
    form(f"Pad/{mode} attributes", N("Pad", A, mode=mode, pads=[0, 0, 1, 2, 0, 0, 3, 1]), opsets=(7, 10))
    form(f"Pad/{mode}", N("Pad", A, i64(0, 0, 1, 2, 0, 0, 3, 1), mode=mode), opsets=(11, 13, 17))
form("Pad/wrap", N("Pad", A, i64(0, 0, 1, 2, 0, 0, 3, 1), mode="wrap"), opsets=(19,))
form("Pad/axes", N("Pad", A, i64(1, 2, 3, 1), c(0.5), i64(2, 3)), opsets=(18,))
form("Pad/negative", N("Pad", A, i64(0, 0, -1, 0, 0, 0, 0, -2)))
form("Pad/negative and positive", N("Pad", A, i64(0, 0, -1, 2, 0, 0, 1, -2)))
form("Pad/reflect negative", N("Pad", A, i64(0, 0, -1, 0, 0, 0, 0, -2), mode="reflect"))
form("Pad/reflect wide", N("Pad", A, i64(0, 0, 3, 4, 0, 0, 3, 4), mode="reflect"))
form("Pad/i64", [N("Cast", A, to=7), N("Pad", "v0_0", i64(0, 0, 1, 2, 0, 0, 3, 1), c(3, "i64"))], cast=True)
form("DepthToSpace", N("DepthToSpace", A, blocksize=2), x=[1, 8, 2, 3], opsets=(7, 11, 13))
form("DepthToSpace/CRD", N("DepthToSpace", A, blocksize=2, mode="CRD"), x=[1, 8, 2, 3], opsets=(11, 13))
form("SpaceToDepth", N("SpaceToDepth", A, blocksize=2), x=[1, 2, 4, 6], opsets=(13,))
form("Trilu", N("Trilu", A), opsets=(14,))
form("Trilu/lower", N("Trilu", A, c(1, "i64"), upper=0), opsets=(14,))
form("ReverseSequence", N("ReverseSequence", A, i64(2, 3), batch_axis=0, time_axis=1), opsets=(10,), x=[2, 4])
form("Compress", [N("Compress", A, c([True, False, True], "bool"), axis=2)], opsets=(11,))
form("NonZero", N("NonZero", A), opsets=(9, 13), cast=True)
form("Unique", N("Unique", A), opsets=(11,))
# --- shapes and constants
form("Shape", N("Shape", A), opsets=(7, 13, 15, 19), cast=True)
form("Shape/part", N("Shape", A, start=1, end=-1), opsets=(15,), cast=True)
form("Size", N("Size", A), opsets=(7, 13), cast=True)
form("ConstantOfShape", [N("Shape", A), N("ConstantOfShape", "v0_0")], opsets=(9, 17))
form(
    "ConstantOfShape/value",
    [N("Shape", A), N("ConstantOfShape", "v0_0", value={"type": "f32", "shape": [1], "data": [2.5]})],
    opsets=(9, 17),
)
form(
    "ConstantOfShape/i64",
    [N("Shape", A), N("ConstantOfShape", "v0_0", value={"type": "i64", "shape": [1], "data": [3]})],
    cast=True,
)
form(
    "ConstantOfShape/bool",
    [N("Shape", A), N("ConstantOfShape", "v0_0", value={"type": "bool", "shape": [1], "data": [1]})],
    cast=True,
)
form(
    "Constant/value",
    [N("Constant", value={"type": "f32", "shape": [5], "data": [1, 2, 3, 4, 5]}), N("Add", A, "v0_0")],
    opsets=(7, 9, 11, 13),
)
form("Constant/value_float", [N("Constant", value_float=0.5), N("Add", A, "v0_0")], opsets=(12, 13))
form("Constant/value_ints", [N("Constant", value_ints=[4, 10]), N("Reshape", A, "v0_0")], opsets=(12, 13))
form("Constant/value_int", [N("Constant", value_int=1), N("Gather", A, "v0_0", axis=1)], opsets=(12, 13))
form(
    "Constant/value_floats",
    [N("Constant", value_floats=[1.0, 2.0, 3.0, 4.0, 5.0]), N("Add", A, "v0_0")],
    opsets=(12, 13),
)
form(
    "Constant/i64",
    [N("Constant", value={"type": "i64", "shape": [2], "data": [4, 10]}), N("Reshape", A, "v0_0")],
)
form("Range", [N("Range", c(0.0), c(5.0), c(1.0)), N("Add", A, "v0_0")], opsets=(11, 17))
form(
    "Range/i64",
    [N("Range", c(0, "i64"), c(5, "i64"), c(1, "i64")), N("Cast", "v0_0", to=1), N("Add", A, "v1_0")],
)
form("Range/steps", [N("Range", c(1.0), c(2.1), c(0.25)), N("Add", A, "v0_0")])
form(
    "Range/down",
    [N("Range", c(5, "i64"), c(0, "i64"), c(-1, "i64")), N("Cast", "v0_0", to=1), N("Add", A, "v1_0")],
)
form("OneHot", [N("Cast", A, to=7), N("OneHot", "v0_0", c(4, "i64"), c([0.0, 1.0]))], opsets=(9, 11))
form(
    "OneHot/axis", [N("Cast", A, to=7), N("OneHot", "v0_0", c(4, "i64"), c([0.0, 1.0]), axis=0)], opsets=(11,)
)
form("EyeLike", N("EyeLike", A), x=[4, 5], opsets=(9,))
# --- reductions
for op in [
    "ReduceMean",
    "ReduceSum",
    "ReduceMax",
    "ReduceMin",
    "ReduceProd",
    "ReduceL1",
    "ReduceL2",
    "ReduceSumSquare",
    "ReduceLogSum",
    "ReduceLogSumExp",
]:
    attribute_until = 12 if op == "ReduceSum" else 17
    ops = [o for o in (7, 11, 12, 13, 17) if o <= attribute_until]
    pre, first = ([N("Abs", A)], "v0_0") if op == "ReduceLogSum" else ([], A)
    form(f"{op}/attribute", pre + [N(op, first, axes=[2, 3])], opsets=ops)
    form(f"{op}/no keepdims", pre + [N(op, first, axes=[1], keepdims=0)], opsets=ops[-1:])
    form(f"{op}/negative", pre + [N(op, first, axes=[-1])], opsets=[o for o in ops if o >= 11][-1:])
    form(f"{op}/all", pre + [N(op, first)], opsets=ops[-2:])
    form(f"{op}/all, no keepdims", pre + [N(op, first, keepdims=0)], opsets=ops[-1:])
    at = (13, 17) if op == "ReduceSum" else (18, 20)
    form(f"{op}/input", pre + [N(op, first, i64(2, 3))], opsets=at)
    form(f"{op}/input, no keepdims", pre + [N(op, first, i64(-1), keepdims=0)], opsets=at)
    form(f"{op}/empty, noop", pre + [N(op, first, noop_with_empty_axes=1)], opsets=at)
    form(f"{op}/empty input", pre + [N(op, first, c(np.array([], np.int64), "i64"))], opsets=at[-1:])
    form(
        f"{op}/empty input, noop",
        pre + [N(op, first, c(np.array([], np.int64), "i64"), noop_with_empty_axes=1)],
        opsets=at[-1:],
    )
form("ReduceMax/i64", [N("Cast", A, to=7), N("ReduceMax", "v0_0", axes=[3])], cast=True)
form("ReduceSum/i64", [N("Cast", A, to=7), N("ReduceSum", "v0_0", i64(3))], cast=True)
form("ReduceProd/i64", [N("Shape", A), N("ReduceProd", "v0_0", axes=[0])], cast=True)
for op in ["ArgMax", "ArgMin"]:
    form(op, N(op, A), opsets=(7, 11, 13), cast=True)
    form(f"{op}/axis", N(op, A, axis=3), cast=True)
    form(f"{op}/negative", N(op, A, axis=-1, keepdims=0), cast=True)
    form(f"{op}/ties", [N("Floor", A), N(op, "v0_0", axis=3)], cast=True)
    form(
        f"{op}/last of ties",
        [N("Floor", A), N(op, "v0_0", axis=3, select_last_index=1)],
        opsets=(12, 13),
        cast=True,
    )
form("TopK/values", N("TopK", A, i64(2), axis=3, outputs=2), opsets=(10, 11, 13))
form("TopK/indices", N("TopK", A, i64(2), axis=3, outputs=2), take=1, cast=True, opsets=(11,))
form("TopK/smallest", N("TopK", A, i64(2), axis=-1, largest=0, outputs=2), opsets=(11,))
form("TopK/ties", [N("Floor", A), N("TopK", "v0_0", i64(3), outputs=2)], take=1, cast=True, opsets=(11,))
form("TopK/attribute", N("TopK", A, k=2, axis=3, outputs=2), opsets=(7, 9))
form("CumSum", N("CumSum", A, c(3, "i64")), opsets=(11, 14))
form("CumSum/exclusive", N("CumSum", A, c(2, "i64"), exclusive=1), opsets=(11,))
form("CumSum/reverse", N("CumSum", A, c(-1, "i64"), reverse=1), opsets=(11,))
form("CumSum/both", N("CumSum", A, c(3, "i64"), reverse=1, exclusive=1), opsets=(14,))
# --- resize
modes = [
    "half_pixel",
    "align_corners",
    "asymmetric",
    "pytorch_half_pixel",
    "half_pixel_symmetric",
    "tf_half_pixel_for_nn",
    "tf_crop_and_resize",
]
UP, DOWN, MIX = c([1.0, 1.0, 2.0, 2.0]), c([1.0, 1.0, 0.5, 0.6]), c([1.0, 1.0, 1.5, 0.8])
for mode, cm in itertools.product(["linear", "nearest", "cubic"], modes):
    for name, s in [("up", UP), ("down", DOWN), ("mixed", MIX)]:
        ops = (11, 13, 17, 18, 19) if cm != "half_pixel_symmetric" else (19,)
        if cm == "tf_half_pixel_for_nn":
            ops = (11,)
        roi = c([0.0, 0.0, 0.1, 0.2, 1.0, 1.0, 0.9, 0.8]) if cm == "tf_crop_and_resize" else None
        form(
            f"Resize/{mode} {cm} {name}",
            N(
                "Resize",
                A,
                roi if roi else (c(np.array([], np.float32)) if min(ops) < 13 else None),
                s,
                mode=mode,
                coordinate_transformation_mode=cm,
            ),
            opsets=ops if name == "up" else ops[-1:],
        )
for nm, cm in itertools.product(["floor", "ceil", "round_prefer_floor", "round_prefer_ceil"], modes[:4]):
    for name, s in [("up", UP), ("down", DOWN), ("mixed", MIX)]:
        form(
            f"Resize/nearest {nm} {cm} {name}",
            N("Resize", A, None, s, mode="nearest", nearest_mode=nm, coordinate_transformation_mode=cm),
            opsets=(13,),
        )
for mode, cm in itertools.product(["linear", "nearest", "cubic"], modes[:4]):
    for name, sizes in [("up", (1, 2, 7, 9)), ("down", (1, 2, 3, 2)), ("one", (1, 2, 1, 1))]:
        form(
            f"Resize/{mode} {cm} sizes {name}",
            N("Resize", A, None, None, i64(*sizes), mode=mode, coordinate_transformation_mode=cm),
            opsets=(13,),
        )
form("Resize/defaults", N("Resize", A, None, UP), opsets=(13, 19))
form("Resize/opset 10", N("Resize", A, UP, mode="linear"), opsets=(10,))
form("Resize/opset 10 nearest", N("Resize", A, UP), opsets=(10,))
form("Resize/antialias", N("Resize", A, None, DOWN, mode="linear", antialias=1), opsets=(18,))
form("Resize/axes", N("Resize", A, None, c([2.0, 2.0]), mode="linear", axes=[2, 3]), opsets=(18,))
form(
    "Resize/aspect",
    N("Resize", A, None, None, i64(7, 7), mode="linear", axes=[2, 3], keep_aspect_ratio_policy="not_larger"),
    opsets=(18,),
)
form("Resize/cubic coefficient", N("Resize", A, None, UP, mode="cubic", cubic_coeff_a=-0.5), opsets=(13,))
form("Resize/exclude_outside", N("Resize", A, None, UP, mode="cubic", exclude_outside=1), opsets=(13,))
form(
    "Resize/linear with other cubic coefficient",
    N("Resize", A, None, UP, mode="linear", cubic_coeff_a=-0.5),
    opsets=(13,),
)
form(
    "Resize/three dimensions",
    N("Resize", A, None, c([1.0, 1.0, 2.0]), mode="linear"),
    opsets=(13,),
    x=[1, 2, 6],
)
form("Resize/two dimensions", N("Resize", A, None, c([2.0, 2.0]), mode="linear"), opsets=(13,), x=[4, 5])
form(
    "Resize/five dimensions",
    N("Resize", A, None, c([1.0, 1.0, 2.0, 2.0, 2.0]), mode="linear"),
    opsets=(13,),
    x=[1, 2, 2, 3, 3],
)
form(
    "Resize/nearest three dimensions",
    N("Resize", A, None, c([1.0, 1.0, 2.0]), mode="nearest"),
    opsets=(13,),
    x=[1, 2, 6],
)
form(
    "Resize/nearest five dimensions",
    N("Resize", A, None, c([1.0, 1.0, 2.0, 2.0, 2.0]), mode="nearest"),
    opsets=(13,),
    x=[1, 2, 2, 3, 3],
)
form("Resize/channels", N("Resize", A, None, c([1.0, 2.0, 1.0, 1.0]), mode="linear"), opsets=(13,))
form("Resize/nearest channels", N("Resize", A, None, c([1.0, 2.0, 1.0, 1.0]), mode="nearest"), opsets=(13,))
form("Resize/height alone", N("Resize", A, None, c([1.0, 1.0, 2.0, 1.0]), mode="linear"), opsets=(13,))
form("Resize/not a whole size", N("Resize", A, None, c([1.0, 1.0, 1.3, 1.3]), mode="linear"), opsets=(13,))
form(
    "Resize/not a whole size, align_corners",
    N(
        "Resize",
        A,
        None,
        c([1.0, 1.0, 1.3, 1.3]),
        mode="linear",
        coordinate_transformation_mode="align_corners",
    ),
    opsets=(13,),
)
form(
    "Resize/not a whole size, nearest",
    N(
        "Resize",
        A,
        None,
        c([1.0, 1.0, 1.3, 1.3]),
        mode="nearest",
        coordinate_transformation_mode="asymmetric",
        nearest_mode="floor",
    ),
    opsets=(13,),
)
form("Resize/same size", N("Resize", A, None, c([1.0, 1.0, 1.0, 1.0]), mode="cubic"), opsets=(13,))
form(
    "Resize/extrapolation",
    N(
        "Resize",
        A,
        c([0.0, 0.0, -0.2, 0.0, 1.0, 1.0, 1.2, 1.0]),
        UP,
        mode="linear",
        coordinate_transformation_mode="tf_crop_and_resize",
        extrapolation_value=3.0,
    ),
    opsets=(13,),
)
for mode in ("nearest", "linear"):
    form(
        f"Upsample/{mode} attribute", N("Upsample", A, mode=mode, scales=[1.0, 1.0, 2.0, 2.0]), opsets=(7, 8)
    )
    form(f"Upsample/{mode} input", N("Upsample", A, UP, mode=mode), opsets=(9,))
    form(f"Upsample/{mode} fraction", N("Upsample", A, c([1.0, 1.0, 1.5, 1.3]), mode=mode), opsets=(9,))
# --- sampling, sequences, control flow, the rest
grid = w(1, 3, 3, 2)
for mode, pm, ac in itertools.product(
    ["bilinear", "nearest", "bicubic"], ["zeros", "border", "reflection"], (0, 1)
):
    form(
        f"GridSample/{mode} {pm} {ac}",
        [N("Mul", grid, c(0.4)), N("GridSample", A, "v0_0", mode=mode, padding_mode=pm, align_corners=ac)],
        opsets=(16,),
    )
form(
    "GridSample/linear, opset 20",
    [N("Mul", grid, c(0.4)), N("GridSample", A, "v0_0", mode="linear")],
    opsets=(20,),
)
form(
    "QuantizeLinear",
    [N("QuantizeLinear", A, c(0.1), c(128, "u8")), N("DequantizeLinear", "v0_0", c(0.1), c(128, "u8"))],
    opsets=(10, 13),
)
form("DynamicQuantizeLinear", [N("DynamicQuantizeLinear", A, outputs=3)], opsets=(11,), cast=True)
form(
    "QuantizeLinear/axis",
    [
        N("QuantizeLinear", A, c([0.1, 0.2]), c([128, 100], "u8"), axis=1),
        N("DequantizeLinear", "v0_0", c([0.1, 0.2]), c([128, 100], "u8"), axis=1),
    ],
    opsets=(13,),
)
form("LSTM", N("LSTM", A, w(1, 12, 5), w(1, 12, 3), hidden_size=3, outputs=3), x=[2, 1, 5], opsets=(14,))
form("GRU", N("GRU", A, w(1, 9, 5), w(1, 9, 3), hidden_size=3, outputs=2), x=[2, 1, 5], opsets=(14,))
form("Det", N("Det", A), x=[2, 3, 3], opsets=(11,))
form("Gelu/microsoft", N("Gelu", A, domain="com.microsoft"))
form("FusedConv", N("FusedConv", A, W, domain="com.microsoft", activation="Relu", kernel_shape=[3, 3]))
form("QuickGelu", N("QuickGelu", A, domain="com.microsoft"))
# --- patterns that the runtime fuses
form("pattern/silu", [N("Sigmoid", A), N("Mul", A, "v0_0")])
form(
    "pattern/gelu",
    [
        N("Div", A, c(1.4142135381698608)),
        N("Erf", "v0_0"),
        N("Add", "v1_0", c(1.0)),
        N("Mul", A, "v2_0"),
        N("Mul", "v3_0", c(0.5)),
    ],
)
form(
    "pattern/gelu tanh",
    [
        N("Pow", A, c(3.0)),
        N("Mul", "v0_0", c(0.044715)),
        N("Add", A, "v1_0"),
        N("Mul", "v2_0", c(0.7978845608)),
        N("Tanh", "v3_0"),
        N("Add", "v4_0", c(1.0)),
        N("Mul", A, "v5_0"),
        N("Mul", "v6_0", c(0.5)),
    ],
)
form(
    "pattern/layer norm",
    [
        N("ReduceMean", A, axes=[-1]),
        N("Sub", A, "v0_0"),
        N("Pow", "v1_0", c(2.0)),
        N("ReduceMean", "v2_0", axes=[-1]),
        N("Add", "v3_0", c(1e-5)),
        N("Sqrt", "v4_0"),
        N("Div", "v1_0", "v5_0"),
        N("Mul", "v6_0", w(5)),
        N("Add", "v7_0", w(5, start=9)),
    ],
)
form(
    "pattern/layer norm over channels",
    [
        N("ReduceMean", A, axes=[1]),
        N("Sub", A, "v0_0"),
        N("Pow", "v1_0", c(2.0)),
        N("ReduceMean", "v2_0", axes=[1]),
        N("Add", "v3_0", c(1e-6)),
        N("Sqrt", "v4_0"),
        N("Div", "v1_0", "v5_0"),
        N("Mul", "v6_0", w(2, 1, 1)),
        N("Add", "v7_0", w(2, 1, 1, start=9)),
    ],
)
form("pattern/matmul add", [N("MatMul", A, w(5, 3)), N("Add", "v0_0", w(3))])
form(
    "pattern/scaled matmul",
    [
        N("Transpose", A, perm=[0, 1, 3, 2]),
        N("MatMul", A, "v0_0"),
        N("Mul", "v1_0", c(0.125)),
        N("Softmax", "v2_0", axis=-1),
        N("MatMul", "v3_0", A),
    ],
)
form("pattern/swish alpha", [N("Mul", A, c(1.702)), N("Sigmoid", "v0_0"), N("Mul", A, "v1_0")])
form("pattern/reciprocal", [N("Abs", A), N("Add", "v0_0", c(0.1)), N("Div", c(1.0), "v1_0")])
form("pattern/identity add", [N("Add", A, c(0.0)), N("Mul", "v0_0", c(1.0))])
form("pattern/reduce mean axes", [N("ReduceMean", A, axes=[2, 3]), N("Sigmoid", "v0_0"), N("Mul", A, "v1_0")])
form(
    "pattern/mask softmax",
    [N("Greater", A, c(0.0)), N("Where", "v0_0", A, c(-np.inf)), N("Softmax", "v1_0", axis=-1)],
)
form("pattern/all masked softmax", [N("Add", A, c(-np.inf)), N("Softmax", "v0_0", axis=-1)])
form(
    "pattern/rms norm",
    [
        N("Pow", A, c(2.0)),
        N("ReduceMean", "v0_0", axes=[-1]),
        N("Add", "v1_0", c(1e-6)),
        N("Sqrt", "v2_0"),
        N("Div", A, "v3_0"),
        N("Mul", "v4_0", w(5)),
    ],
)


# What the embedded runtime refuses: it would compute some of these wrongly without a word (marked), and has
# no code for the others.
REFUSED = [
    "Resize/cubic*",  # computed as linear
    "*same lower*",  # padded as SAME_UPPER
    "Cast/bool*",
    "Cast/i64 then bool",  # 2 stays 2
    "Cast/u8",
    "Cast/i8",  # saturated
    "Cast/f16",
    "Cast/f64",
    "CastLike",  # computed in f32
    "* beyond 32 bits",  # whole numbers of 32 bits
    "MatMul/vector",  # keeps a dimension
    "*noop*",  # reduces after all, or changes the shape
    "Cast/i16",
    "Cast/bf16",
    "Cast/u32",
    "Cast/f64 constant",
    "Bitwise*",
    "Pow/int*exponent",
    "Mish",
    "Celu",
    "Selu",
    "ThresholdedRelu",
    "Shrink",
    "Hardmax",
    "Dropout*",
    "LpPool",
    "GroupNormalization",
    "LRN",
    "MeanVarianceNormalization",
    "SpaceToDepth",
    "Compress",
    "Unique",
    "Det",
    "LSTM",
    "GRU",
    "*QuantizeLinear*",
    "Gelu/microsoft",
    "FusedConv",
    "QuickGelu",
    "IsInf/positive",
    "*last of ties",
    "Conv/*no kernel_shape",
    "ConvTranspose/no kernel_shape",
    "ConvTranspose/output_shape",
    "*/three dimensions",
    "*Pool/no strides",
    "*Pool/dilations",
    "MaxPool/storage_order",
    "MaxPool/indices",
    "BatchNormalization/training",
    "LayerNormalization/mean",
    "Pad/axes",
    "Slice/no axes",
    "Slice/attributes without axes",
    "Resize/*half_pixel_symmetric*",
    "Resize/*tf_*",
    "Resize/opset 10*",
    "Resize/antialias",
    "Resize/axes",
    "Resize/aspect",
    "Resize/*coefficient",
    "Resize/exclude_outside",
    "Resize/*five dimensions",
    "Resize/*channels",
    "Resize/extrapolation",
    "Resize/same size",  # cubic too
    "GridSample/nearest*",
    "GridSample/bicubic*",
    "GridSample/* border *",
    "GridSample/* reflection *",
]
# Resized in one direction, or pooled in one, they are computed.
COMPUTED = ["Resize/three dimensions", "Resize/nearest three dimensions"]


def runs(name, opset):
    """Whether the embedded runtime computes a form at this version of the operator set."""
    if name.split("/")[0] in ("Softmax", "LogSoftmax") and opset < 13:
        # All axes from this one on were one; -1 is the last in either reading.
        return name.endswith("axis -1")
    match = fnmatch.fnmatchcase
    return any(match(name, p) for p in COMPUTED) or not any(match(name, p) for p in REFUSED)


def main():
    lines, broken = [], 0
    for f in FORMS:
        d = described(f)
        groups = {}
        # The newest version too, where the form still exists there.
        more = [21] if max(d["opsets"]) in range(17, 21) else []
        for opset in d["opsets"] + more:
            try:
                y = run(d, opset)
            except Exception as error:
                if opset not in more:
                    broken += 1
                    print(f"{d['name']} opset {opset}: ONNX Runtime: {str(error)[:150]}", file=sys.stderr)
                continue
            computed = runs(d["name"], opset)
            key = (computed, y.shape, y.astype(np.float32).tobytes() if computed else b"")
            groups.setdefault(key, []).append(opset)
        for (computed, shape, raw), opsets in groups.items():
            y = np.frombuffer(raw, np.float32)
            numbers = [float(str(v)) if np.isfinite(v) else str(v) for v in y]
            found = {**d, "opsets": opsets, "runs": computed, "shape": list(shape), "y": numbers}
            lines.append(json.dumps(found, separators=(",", ":")))
    out = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else pathlib.Path(__file__).with_name("forms.json")
    out.write_text("[\n" + ",\n".join(lines) + "\n]\n")
    print(f"{len(lines)} forms, {broken} not run by ONNX Runtime", file=sys.stderr)


if __name__ == "__main__":
    main()
