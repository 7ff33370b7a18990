//! The operator forms of `forms.json`: their graphs and what ONNX Runtime computed for them.
//!
//! `make.py` beside this file is the recipe. `bench` holds the same graphs against the ONNX Runtime that it
//! finds.

use std::collections::BTreeMap;

use prost::Message;
use prost::bytes::Bytes;
use serde::Deserialize;
use serde_json::Value;
use strat_onnx::proto::{
    AttributeProto, Dimension, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, TensorProto,
    TensorShapeProto, TypeProto, ValueInfoProto, attribute_type, data_type, dimension, type_proto,
};

/// A small graph around one operator.
#[derive(Debug, Deserialize)]
pub struct Form {
    pub name: String,
    /// Versions of the operator set that give these values.
    pub opsets: Vec<i64>,
    /// Shape of the input `x`, which [`values`] fills.
    pub x: Vec<usize>,
    constants: BTreeMap<String, Constant>,
    nodes: Vec<Node>,
    /// Whether the embedded runtime computes it; it refuses it otherwise.
    pub runs: bool,
    /// Shape of the output `y`.
    pub shape: Vec<usize>,
    /// What ONNX Runtime computed; words for what is not finite.
    y: Vec<Value>,
}

#[derive(Debug, Deserialize)]
struct Constant {
    r#type: String,
    shape: Vec<usize>,
    /// Elements, or where [`values`] begins.
    data: Option<Vec<Value>>,
    start: Option<usize>,
}

#[derive(Debug, Deserialize)]
struct Node {
    op: String,
    domain: String,
    inputs: Vec<String>,
    outputs: Vec<String>,
    attributes: serde_json::Map<String, Value>,
}

/// The forms of `forms.json`.
pub fn read(text: &str) -> Vec<Form> {
    serde_json::from_str(text).expect("forms.json is what make.py wrote")
}

/// Multiples of 1/16 between -3.125 and 3.125 in an order without a pattern, as `make.py` has them.
pub fn values(shape: &[usize], start: usize) -> Vec<f32> {
    let count: usize = shape.iter().product();
    let value = |i: usize| (((start + i) * 37 + 11) % 101) as f32 - 50.0;
    (0..count).map(|i| value(i) / 16.0).collect()
}

impl Form {
    /// What ONNX Runtime computed.
    pub fn y(&self) -> Vec<f32> {
        self.y
            .iter()
            .map(number)
            .map(|value| value as f32)
            .collect()
    }

    /// The encoded model at a version of the operator set.
    pub fn model(&self, opset: i64) -> Vec<u8> {
        let mut domains = self.nodes.iter().map(|node| node.domain.as_str());
        let foreign = domains.rfind(|domain| !domain.is_empty());
        let import = |domain: &str, version| OperatorSetIdProto {
            domain: Some(domain.to_owned()),
            version: Some(version),
        };
        let mut opset_import = vec![import("", opset)];
        opset_import.extend(foreign.map(|domain| import(domain, 1)));
        let constants = self.constants.iter();
        let graph = GraphProto {
            name: Some(self.name.clone()),
            input: vec![value_info("x", Some(&self.x))],
            output: vec![value_info("y", None)],
            initializer: constants.map(|(name, c)| c.tensor(name)).collect(),
            node: self
                .nodes
                .iter()
                .enumerate()
                .map(|(i, node)| node.proto(i))
                .collect(),
            ..GraphProto::default()
        };
        let model = ModelProto {
            ir_version: Some(8),
            opset_import,
            graph: Some(graph),
            ..ModelProto::default()
        };
        model.encode_to_vec()
    }
}

impl Node {
    fn proto(&self, number: usize) -> NodeProto {
        NodeProto {
            name: Some(format!("n{number}")),
            op_type: Some(self.op.clone()),
            domain: Some(self.domain.clone()),
            input: self.inputs.clone(),
            output: self.outputs.clone(),
            attribute: self
                .attributes
                .iter()
                .map(|(name, value)| attribute(name, value))
                .collect(),
            ..NodeProto::default()
        }
    }
}

impl Constant {
    fn tensor(&self, name: &str) -> TensorProto {
        let numbers: Vec<f64> = match (&self.data, self.start) {
            (Some(data), _) => data.iter().map(number).collect(),
            (None, start) => values(&self.shape, start.unwrap_or(0))
                .into_iter()
                .map(f64::from)
                .collect(),
        };
        let (data_type, raw): (i32, Vec<u8>) = match self.r#type.as_str() {
            "f32" => (
                data_type::FLOAT,
                numbers
                    .iter()
                    .flat_map(|v| (*v as f32).to_le_bytes())
                    .collect(),
            ),
            "f64" => (
                data_type::DOUBLE,
                numbers.iter().flat_map(|v| v.to_le_bytes()).collect(),
            ),
            "f16" => (
                data_type::FLOAT16,
                numbers
                    .iter()
                    .flat_map(|v| half_bits(*v as f32).to_le_bytes())
                    .collect(),
            ),
            "i64" => (
                data_type::INT64,
                self.whole().flat_map(i64::to_le_bytes).collect(),
            ),
            "i32" => (
                data_type::INT32,
                self.whole()
                    .flat_map(|v| (v as i32).to_le_bytes())
                    .collect(),
            ),
            "i8" => (
                data_type::INT8,
                self.whole().map(|v| v as i8 as u8).collect(),
            ),
            "u8" => (data_type::UINT8, self.whole().map(|v| v as u8).collect()),
            "bool" => (data_type::BOOL, self.whole().map(|v| v as u8).collect()),
            other => panic!("a constant of type {other}"),
        };
        TensorProto {
            name: Some(name.to_owned()),
            dims: self.shape.iter().map(|size| *size as i64).collect(),
            data_type: Some(data_type),
            raw_data: Some(Bytes::from(raw)),
            ..TensorProto::default()
        }
    }

    /// Whole numbers, some of which an `f64` cannot hold.
    fn whole(&self) -> impl Iterator<Item = i64> {
        let data = self.data.iter().flatten();
        data.map(|value| value.as_i64().expect("a whole number"))
    }
}

/// Half precision of a number that it holds exactly.
fn half_bits(value: f32) -> u16 {
    let bits = value.to_bits();
    let exponent = ((bits >> 23) & 0xff) - 112;
    ((bits >> 16) & 0x8000 | exponent << 10 | (bits >> 13) & 0x3ff) as u16
}

fn number(value: &Value) -> f64 {
    match value {
        Value::String(word) => word.parse().expect("inf, -inf or nan"),
        value => value.as_f64().expect("a number"),
    }
}

/// Numbers with a decimal point are floats, as in Python.
fn attribute(name: &str, value: &Value) -> AttributeProto {
    let named = |kind| AttributeProto {
        name: Some(name.to_owned()),
        r#type: Some(kind),
        ..AttributeProto::default()
    };
    match value {
        Value::Number(v) if v.is_i64() => AttributeProto {
            i: v.as_i64(),
            ..named(attribute_type::INT)
        },
        Value::Number(v) => AttributeProto {
            f: v.as_f64().map(|v| v as f32),
            ..named(attribute_type::FLOAT)
        },
        Value::String(text) => AttributeProto {
            s: Some(Bytes::copy_from_slice(text.as_bytes())),
            ..named(attribute_type::STRING)
        },
        Value::Array(items) if items.iter().all(Value::is_i64) => AttributeProto {
            ints: items.iter().filter_map(Value::as_i64).collect(),
            ..named(attribute_type::INTS)
        },
        Value::Array(items) => AttributeProto {
            floats: items.iter().map(|v| number(v) as f32).collect(),
            ..named(6)
        },
        tensor => {
            let constant: Constant = serde_json::from_value(tensor.clone()).expect("a constant");
            AttributeProto {
                t: Some(constant.tensor("")),
                ..named(4)
            }
        }
    }
}

fn value_info(name: &str, shape: Option<&[usize]>) -> ValueInfoProto {
    let dim = |size: &usize| Dimension {
        value: Some(dimension::Value::DimValue(*size as i64)),
        denotation: None,
    };
    let shape = shape.map(|shape| TensorShapeProto {
        dim: shape.iter().map(dim).collect(),
    });
    let tensor = type_proto::Tensor {
        elem_type: Some(data_type::FLOAT),
        shape,
    };
    ValueInfoProto {
        name: Some(name.to_owned()),
        r#type: Some(TypeProto {
            value: Some(type_proto::Value::TensorType(tensor)),
            denotation: None,
        }),
        ..ValueInfoProto::default()
    }
}

/// Largest difference, relative where numbers are above 1; what is not a number is its own equal.
pub fn difference(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let difference = |(found, expected): (&f32, &f32)| {
        if found == expected || found.is_nan() && expected.is_nan() {
            return 0.0;
        }
        let difference = (found - expected).abs() / expected.abs().max(1.0);
        if difference.is_nan() {
            f32::INFINITY
        } else {
            difference
        }
    };
    found
        .iter()
        .zip(expected)
        .map(difference)
        .fold(0.0, f32::max)
}
