//! Parts of the protobuf messages of a graph.

use half::f16;
use prost::bytes::Bytes;

use super::shapes::{Dim, Geometry};
use crate::proto::{
    self, AttributeProto, NodeProto, TensorProto, TensorShapeProto, TypeProto, ValueInfoProto,
    attribute_type, data_type, dimension, type_proto,
};

/// Rounds a filter to half precision under another name and returns the node that gives it back
/// under its own; nothing for other constants.
pub(super) fn halve(tensor: &mut TensorProto) -> Option<NodeProto> {
    if tensor.data_type != Some(data_type::FLOAT) || tensor.dims.len() < 2 {
        return None;
    }
    let name = tensor.name.clone()?;
    let raw = tensor.raw_data.as_ref()?;
    let (numbers, _) = raw.as_chunks::<4>();
    let halves = numbers
        .iter()
        .flat_map(|bytes| f16::from_f32(f32::from_le_bytes(*bytes)).to_le_bytes())
        .collect::<Vec<u8>>();
    let stored = format!("{name}.f16");
    tensor.raw_data = Some(Bytes::from(halves));
    tensor.data_type = Some(data_type::FLOAT16);
    tensor.name = Some(stored.clone());
    Some(NodeProto {
        input: vec![stored],
        output: vec![name.clone()],
        name: Some(format!("{name}.cast")),
        op_type: Some("Cast".to_owned()),
        attribute: vec![attribute_int("to", i64::from(data_type::FLOAT))],
        ..NodeProto::default()
    })
}

pub(super) fn window_attributes(kernel: [usize; 2], geometry: &Geometry) -> Vec<AttributeProto> {
    vec![
        attribute_ints("kernel_shape", &kernel),
        attribute_ints("strides", &geometry.stride),
        attribute_ints("pads", &geometry.pads),
        attribute_ints("dilations", &geometry.dilation),
    ]
}

fn attribute(name: &str, kind: i32) -> AttributeProto {
    AttributeProto {
        name: Some(name.to_owned()),
        r#type: Some(kind),
        ..AttributeProto::default()
    }
}

pub(super) fn attribute_int(name: &str, value: i64) -> AttributeProto {
    AttributeProto {
        i: Some(value),
        ..attribute(name, attribute_type::INT)
    }
}

fn attribute_ints(name: &str, values: &[usize]) -> AttributeProto {
    AttributeProto {
        ints: values.iter().map(|&value| value as i64).collect(),
        ..attribute(name, attribute_type::INTS)
    }
}

pub(super) fn attribute_float(name: &str, value: f32) -> AttributeProto {
    AttributeProto {
        f: Some(value),
        ..attribute(name, attribute_type::FLOAT)
    }
}

pub(super) fn attribute_string(name: &str, value: &str) -> AttributeProto {
    AttributeProto {
        s: Some(Bytes::copy_from_slice(value.as_bytes())),
        ..attribute(name, attribute_type::STRING)
    }
}

pub(super) fn value_info(name: &str, dims: &[Dim]) -> ValueInfoProto {
    let dim = |dim: &Dim| proto::Dimension {
        value: match dim {
            Dim::Fixed(size) => Some(dimension::Value::DimValue(*size as i64)),
            Dim::Symbolic(name) => Some(dimension::Value::DimParam(name.clone())),
            Dim::Unknown => None,
        },
        denotation: None,
    };
    ValueInfoProto {
        name: Some(name.to_owned()),
        r#type: Some(TypeProto {
            value: Some(type_proto::Value::TensorType(type_proto::Tensor {
                elem_type: Some(data_type::FLOAT),
                shape: Some(TensorShapeProto {
                    dim: dims.iter().map(dim).collect(),
                }),
            })),
            denotation: None,
        }),
        ..ValueInfoProto::default()
    }
}
