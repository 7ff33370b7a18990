//! The operator forms that the embedded runtime computes as ONNX defines them.
//!
//! rten reads more than it computes: it takes `Resize` in mode cubic for linear, pads SAME_LOWER as
//! SAME_UPPER, knows whole numbers of 32 bits only and has one meaning for each operator where ONNX has
//! changed it between versions. Here is what it may be given: operators with their versions, attributes
//! and types, each held against ONNX Runtime by `tests/forms`. All else is refused by its name.
//!
//! Not here: shapes, which the runtime checks itself where it has no code for one; sums of whole numbers
//! that leave 32 bits while the model runs; and values that are not
//! numbers, which some of its operators (`Relu`, `Clip`, `ReduceMax`) drop where ONNX keeps them.

use std::collections::{HashMap, HashSet};

use super::sizes::numbers;
use crate::proto::{AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto, data_type};

/// Versions of the operator set that the forms were held against.
const OPSETS: std::ops::RangeInclusive<i64> = 7..=21;

/// What an attribute may be.
#[derive(Clone, Copy)]
enum May {
    /// Any value.
    Vary,
    /// One of these numbers.
    Be(&'static [i64]),
    /// One of these words.
    Say(&'static [&'static str]),
    /// A list of ones.
    BeOnes,
    /// This number with a point.
    Stay(f32),
}

use May::{Be, BeOnes, Say, Stay, Vary};

type Attributes = &'static [(&'static str, May)];

const NONE: Attributes = &[];
const AXIS: Attributes = &[("axis", Vary)];
const ZERO: May = Be(&[0]);
const PADDING: May = Say(&["NOTSET", "VALID", "SAME_UPPER"]);
const WINDOW: Attributes = &[
    ("auto_pad", PADDING),
    ("kernel_shape", Vary),
    ("strides", Vary),
    ("pads", Vary),
    ("dilations", Vary),
    ("group", Vary),
];
const POOL: Attributes = &[
    ("auto_pad", PADDING),
    ("kernel_shape", Vary),
    ("strides", Vary),
    ("pads", Vary),
    ("dilations", BeOnes),
    ("ceil_mode", Vary),
    ("count_include_pad", Vary),
    ("storage_order", ZERO),
];
const REDUCE: Attributes = &[
    ("axes", Vary),
    ("keepdims", Vary),
    ("noop_with_empty_axes", ZERO),
];
const ARG: Attributes = &[
    ("axis", Vary),
    ("keepdims", Vary),
    ("select_last_index", ZERO),
];
const SCATTER: Attributes = &[("axis", Vary), ("reduction", Vary)];
const RESIZE: Attributes = &[
    ("mode", Say(&["nearest", "linear"])),
    (
        "coordinate_transformation_mode",
        Say(&[
            "half_pixel",
            "pytorch_half_pixel",
            "align_corners",
            "asymmetric",
        ]),
    ),
    (
        "nearest_mode",
        Say(&["floor", "ceil", "round_prefer_floor", "round_prefer_ceil"]),
    ),
    ("antialias", ZERO),
    ("exclude_outside", ZERO),
    ("cubic_coeff_a", Stay(-0.75)),
    ("extrapolation_value", Stay(0.0)),
    ("keep_aspect_ratio_policy", Say(&["stretch"])),
];

/// Attributes of an operator and the first version of the operator set with which it may be used.
fn form(op: &str) -> Option<(i64, Attributes)> {
    let attributes = match op {
        "Abs" | "Acos" | "Acosh" | "Add" | "And" | "Asin" | "Asinh" | "Atan" | "Atanh" | "Ceil"
        | "Cos" | "Cosh" | "Div" | "Equal" | "Erf" | "Exp" | "Expand" | "Floor"
        | "GlobalAveragePool" | "GlobalMaxPool" | "Greater" | "GreaterOrEqual" | "HardSwish"
        | "Identity" | "IsNaN" | "Less" | "LessOrEqual" | "Log" | "MatMul" | "Max" | "Mean"
        | "Min" | "Mul" | "Neg" | "NonZero" | "Not" | "Or" | "PRelu" | "Pow" | "Range"
        | "Reciprocal" | "Relu" | "Round" | "Sigmoid" | "Sign" | "Sin" | "Sinh" | "Size"
        | "Softplus" | "Softsign" | "Sqrt" | "Sub" | "Sum" | "Tan" | "Tanh" | "Tile" | "Where"
        | "Xor" => NONE,
        "ArgMax" | "ArgMin" => ARG,
        "AveragePool" | "MaxPool" => POOL,
        "BatchNormalization" => &[
            ("epsilon", Vary),
            ("momentum", Vary),
            ("training_mode", ZERO),
            ("spatial", Be(&[1])),
        ],
        "Cast" => &[("to", Be(&[1, 6, 7])), ("saturate", Be(&[1]))],
        "Clip" => &[("min", Vary), ("max", Vary)],
        "Concat" | "Flatten" | "Gather" | "GatherElements" | "LogSoftmax" | "OneHot"
        | "Softmax" => AXIS,
        "Constant" => &[
            ("value", Vary),
            ("value_float", Vary),
            ("value_floats", Vary),
            ("value_int", Vary),
            ("value_ints", Vary),
        ],
        "ConstantOfShape" => &[("value", Vary)],
        "Conv" => WINDOW,
        "ConvTranspose" => &[
            ("auto_pad", PADDING),
            ("kernel_shape", Vary),
            ("strides", Vary),
            ("pads", Vary),
            ("dilations", Vary),
            ("group", Vary),
            ("output_padding", Vary),
        ],
        "CumSum" => &[("exclusive", Vary), ("reverse", Vary)],
        "DepthToSpace" => &[("blocksize", Vary), ("mode", Vary)],
        "Einsum" => &[("equation", Vary)],
        "Elu" | "LeakyRelu" => &[("alpha", Vary)],
        "EyeLike" => &[("k", Vary)],
        "GatherND" => &[("batch_dims", Vary)],
        "Gelu" => &[("approximate", Vary)],
        "Gemm" => &[
            ("alpha", Vary),
            ("beta", Vary),
            ("transA", Vary),
            ("transB", Vary),
        ],
        "GridSample" => &[
            ("mode", Say(&["bilinear", "linear"])),
            ("padding_mode", Say(&["zeros"])),
            ("align_corners", Vary),
        ],
        "HardSigmoid" => &[("alpha", Vary), ("beta", Vary)],
        "InstanceNormalization" => &[("epsilon", Vary)],
        "IsInf" => &[("detect_positive", Be(&[1])), ("detect_negative", Be(&[1]))],
        "LayerNormalization" => &[("axis", Vary), ("epsilon", Vary), ("stash_type", Be(&[1]))],
        "LpNormalization" => &[("axis", Vary), ("p", Vary)],
        "Mod" => &[("fmod", Vary)],
        "Pad" => &[("mode", Vary), ("pads", Vary), ("value", Vary)],
        "ReduceL1" | "ReduceL2" | "ReduceLogSum" | "ReduceLogSumExp" | "ReduceMax"
        | "ReduceMean" | "ReduceMin" | "ReduceProd" | "ReduceSum" | "ReduceSumSquare" => REDUCE,
        "Reshape" => &[("allowzero", Vary)],
        "Resize" => RESIZE,
        "ReverseSequence" => &[("batch_axis", Vary), ("time_axis", Vary)],
        "ScatterElements" | "ScatterND" => SCATTER,
        "Shape" => &[("start", Vary), ("end", Vary)],
        "Slice" => &[("starts", Vary), ("ends", Vary), ("axes", Vary)],
        "Split" => &[("axis", Vary), ("split", Vary), ("num_outputs", Vary)],
        "Squeeze" | "Unsqueeze" => &[("axes", Vary)],
        "TopK" => &[
            ("axis", Vary),
            ("k", Vary),
            ("largest", Vary),
            ("sorted", Be(&[1])),
        ],
        "Transpose" => &[("perm", Vary)],
        "Trilu" => &[("upper", Vary)],
        "Upsample" => &[("mode", Say(&["nearest", "linear"])), ("scales", Vary)],
        _ => return None,
    };
    let first = match op {
        // Version 10 has its inputs in another order.
        "Resize" => 11,
        "GridSample" => 16,
        _ => *OPSETS.start(),
    };
    Some((first, attributes))
}

/// Refuses a model with a form that the embedded runtime would compute otherwise than ONNX says, or not at
/// all.
///
/// # Errors
/// With the node and what it is about it, as part of a sentence.
pub(super) fn check(model: &ModelProto) -> Result<(), String> {
    let imports = model.opset_import.iter();
    let own =
        imports.filter(|entry| matches!(entry.domain.as_deref(), None | Some("" | "ai.onnx")));
    let opset = own
        .filter_map(|entry| entry.version)
        .next_back()
        .unwrap_or(0);
    if !OPSETS.contains(&opset) {
        let (first, last) = (OPSETS.start(), OPSETS.end());
        return Err(format!(
            "it uses version {opset} of the operator set, not {first} to {last}"
        ));
    }
    if let Some(function) = model.functions.first() {
        let name = function.name.as_deref().unwrap_or_default();
        return Err(format!("it defines the function \"{name}\""));
    }
    let Some(graph) = &model.graph else {
        return Ok(());
    };
    if !graph.sparse_initializer.is_empty() {
        return Err("it has sparse constants".to_owned());
    }
    let constants = Constants::new(graph);
    constants.check(graph)?;
    graph
        .node
        .iter()
        .try_for_each(|node| check_node(node, opset, &constants))
}

/// The tensors that a graph names.
struct Constants<'a>(HashMap<&'a str, &'a TensorProto>);

impl<'a> Constants<'a> {
    fn new(graph: &'a GraphProto) -> Self {
        let named = graph
            .initializer
            .iter()
            .filter_map(|t| Some((t.name.as_deref()?, t)));
        let constant = |node: &'a NodeProto| -> Option<(&'a str, &'a TensorProto)> {
            if node.op_type.as_deref() != Some("Constant") {
                return None;
            }
            let tensor = node
                .attribute
                .iter()
                .find_map(|attribute| attribute.t.as_ref())?;
            Some((node.output.first()?.as_str(), tensor))
        };
        Self(
            named
                .chain(graph.node.iter().filter_map(constant))
                .collect(),
        )
    }

    /// Types that the runtime computes with, and whole numbers within its range.
    fn check(&self, graph: &GraphProto) -> Result<(), String> {
        // Weights in half precision are made wider before they are used; a slice to "the end" is cut.
        let mut wide = HashSet::new();
        let mut halves = HashSet::new();
        for node in &graph.node {
            for (index, name) in node.input.iter().enumerate() {
                match (node.op_type.as_deref(), index) {
                    (Some("Slice"), 1 | 2) => {}
                    _ => drop(wide.insert(name.as_str())),
                }
                if node.op_type.as_deref() != Some("Cast") {
                    halves.insert(name.as_str());
                }
            }
        }
        for (name, tensor) in &self.0 {
            match tensor.data_type.unwrap_or(0) {
                data_type::FLOAT | data_type::INT32 | data_type::BOOL => {}
                data_type::FLOAT16 if !halves.contains(name) => {}
                data_type::INT64 => {
                    let fits = |value: &f64| value.abs() <= f64::from(i32::MAX);
                    let all = numbers(tensor).is_none_or(|numbers| numbers.iter().all(fits));
                    if wide.contains(name) && !all {
                        return Err(format!("its constant \"{name}\" needs more than 32 bits"));
                    }
                }
                other => {
                    let kind = crate::model::ElementType(other);
                    return Err(format!("its constant \"{name}\" is of type {kind}"));
                }
            }
        }
        Ok(())
    }

    fn rank(&self, name: Option<&String>) -> Option<usize> {
        Some(self.0.get(name?.as_str())?.dims.len())
    }
}

fn check_node(node: &NodeProto, opset: i64, constants: &Constants) -> Result<(), String> {
    let op = node.op_type.as_deref().unwrap_or_default();
    let domain = node.domain.as_deref().unwrap_or_default();
    let name = node.name.as_deref().unwrap_or_default();
    let refuse = |problem: String| Err(format!("its {op} node \"{name}\" {problem}"));
    if !matches!(domain, "" | "ai.onnx") {
        return refuse(format!("is of the domain {domain}"));
    }
    let Some((first, known)) = form(op) else {
        return refuse("is an operator that it does not compute".to_owned());
    };
    if opset < first {
        return refuse(format!(
            "is of version {opset} of the operator set, before {first}"
        ));
    }
    for attribute in &node.attribute {
        let key = attribute.name.as_deref().unwrap_or_default();
        let rule = known.iter().find(|(name, _)| *name == key);
        if !rule.is_some_and(|(_, rule)| allows(*rule, attribute)) {
            return refuse(format!("has {key} = {}", shown(attribute)));
        }
    }
    let attribute = |key: &str| {
        node.attribute
            .iter()
            .find(|attribute| attribute.name.as_deref() == Some(key))
    };
    let outputs = node.output.iter().filter(|name| !name.is_empty()).count();
    match op {
        "Conv" | "ConvTranspose" | "MaxPool" | "AveragePool" => {
            let dimensions = attribute("kernel_shape").map_or(0, |kernel| kernel.ints.len());
            if !matches!(dimensions, 1 | 2) {
                return refuse("does not state a kernel_shape of one or two numbers".to_owned());
            }
            if op.ends_with("Pool") && attribute("strides").is_none() {
                return refuse("does not state its strides".to_owned());
            }
        }
        // Before version 13 all axes from this one on were one.
        "Softmax" | "LogSoftmax" if opset < 13 => {
            let axis = attribute("axis").and_then(|axis| axis.i).unwrap_or(1);
            if axis != -1 {
                return refuse(format!(
                    "has axis = {axis}, which in version {opset} of the operator set joins the axes \
                     behind it"
                ));
            }
        }
        "MatMul"
            if node
                .input
                .iter()
                .any(|name| constants.rank(Some(name)) == Some(1)) =>
        {
            return refuse("multiplies by a vector".to_owned());
        }
        "Pad" if node.input.get(3).is_some_and(|axes| !axes.is_empty()) => {
            return refuse("has an input axes".to_owned());
        }
        _ => {}
    }
    if outputs > 1 && !matches!(op, "Split" | "TopK") {
        return refuse("has more than one output".to_owned());
    }
    Ok(())
}

fn allows(rule: May, attribute: &AttributeProto) -> bool {
    match rule {
        Vary => attribute.g.is_none() && attribute.graphs.is_empty(),
        Be(values) => values.contains(&attribute.i.unwrap_or(0)),
        Say(words) => words
            .iter()
            .any(|word| attribute.s.as_deref() == Some(word.as_bytes())),
        BeOnes => attribute.ints.iter().all(|value| *value == 1),
        Stay(value) => attribute.f.unwrap_or(0.0) == value,
    }
}

/// An attribute's value for a sentence.
fn shown(attribute: &AttributeProto) -> String {
    match attribute {
        AttributeProto { s: Some(word), .. } => String::from_utf8_lossy(word).into_owned(),
        AttributeProto { i: Some(value), .. } => value.to_string(),
        AttributeProto { f: Some(value), .. } => value.to_string(),
        AttributeProto { ints, .. } if !ints.is_empty() => format!("{ints:?}"),
        _ => "a value of another kind".to_owned(),
    }
}
