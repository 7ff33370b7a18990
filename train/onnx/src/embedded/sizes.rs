//! The sizes of all values of a graph, worked out before anything is allocated.
//!
//! A model of a few bytes can ask for a tensor of 10^12 values, by a declared input, a constant shape or a
//! factor, and the allocation would end the process. The shapes are followed from the input and the
//! constants through the graph; where they cannot be followed (what depends on the values of an image),
//! nothing is refused. Not here: what an operator's values are, and the runtime's scratch memory.

use std::collections::HashMap;

use super::shapes::{Known, Step};
use crate::proto::{AttributeProto, GraphProto, NodeProto, TensorProto, data_type};

/// Most values of one tensor: 4 GiB of `f32`, sixty times a feature map of a full-size network.
pub(super) const MOST_VALUES: u64 = 1 << 30;

/// Numbers that are followed: shapes, factors and axes have no more.
const MOST_NUMBERS: usize = 64;

/// The graph without its weights.
pub(super) struct Sizes {
    constants: HashMap<String, Known>,
    nodes: Vec<NodeProto>,
}

impl Sizes {
    /// Keeps what the sizes of a graph depend on.
    pub fn new(graph: &GraphProto) -> Self {
        let mut constants: HashMap<String, Known> = HashMap::new();
        for tensor in &graph.initializer {
            constants.insert(tensor.name.clone().unwrap_or_default(), constant(tensor));
        }
        let mut nodes = Vec::new();
        for node in &graph.node {
            match (node.op_type.as_deref(), node.output.first()) {
                (Some("Constant"), Some(output)) => {
                    let known = node.attribute.first().map(constant_attribute);
                    constants.insert(output.clone(), known.unwrap_or_default());
                }
                _ => nodes.push(node.clone()),
            }
        }
        Self { constants, nodes }
    }

    /// Refuses an input whose values, or those that the graph makes of it, are too many.
    ///
    /// # Errors
    /// With the node and its size, as part of a sentence.
    pub fn check(&self, input: &str, shape: &[usize]) -> Result<(), String> {
        let shape: Vec<u64> = shape.iter().map(|size| *size as u64).collect();
        limit(&format!("the input \"{input}\""), &shape)?;
        let mut values: HashMap<&str, Known> = HashMap::new();
        for (name, known) in &self.constants {
            if let Some(shape) = &known.shape {
                limit(&format!("the constant \"{name}\""), shape)?;
            }
            values.insert(name, known.clone());
        }
        let known = Known {
            shape: Some(shape),
            numbers: None,
        };
        values.insert(input, known);
        for node in &self.nodes {
            let absent = Known::default();
            let inputs = node.input.iter().map(|name| values.get(name.as_str()));
            let inputs: Vec<&Known> = inputs.map(|known| known.unwrap_or(&absent)).collect();
            let known = Step { node, inputs }.result().unwrap_or_default();
            let op = node.op_type.as_deref().unwrap_or_default();
            let name = node.name.as_deref().unwrap_or_default();
            if let Some(shape) = &known.shape {
                limit(&format!("the result of the {op} node \"{name}\""), shape)?;
            }
            // Further outputs (of Split, TopK) are no larger than the first input.
            if let Some(output) = node.output.first() {
                values.insert(output, known);
            }
        }
        Ok(())
    }
}

fn limit(what: &str, shape: &[u64]) -> Result<(), String> {
    let count = shape
        .iter()
        .try_fold(1_u64, |product, &size| product.checked_mul(size));
    match count {
        Some(count) if count <= MOST_VALUES => Ok(()),
        _ => Err(format!(
            "{what} would be {shape:?}, more than the {MOST_VALUES} values that one may have"
        )),
    }
}

fn constant(tensor: &TensorProto) -> Known {
    let shape: Option<Vec<u64>> = tensor
        .dims
        .iter()
        .map(|&size| u64::try_from(size).ok())
        .collect();
    let few = shape
        .as_ref()
        .is_some_and(|shape| shape.iter().product::<u64>() <= MOST_NUMBERS as u64);
    Known {
        numbers: few.then(|| numbers(tensor)).flatten(),
        shape,
    }
}

/// The elements of a small tensor of floats or whole numbers.
pub(super) fn numbers(tensor: &TensorProto) -> Option<Vec<f64>> {
    let raw = tensor.raw_data.as_deref().filter(|raw| !raw.is_empty());
    Some(match (tensor.data_type?, raw) {
        (data_type::INT64, Some(raw)) => raw
            .as_chunks::<8>()
            .0
            .iter()
            .map(|b| i64::from_le_bytes(*b) as f64)
            .collect(),
        (data_type::INT64, None) => tensor.int64_data.iter().map(|v| *v as f64).collect(),
        (data_type::INT32, Some(raw)) => raw
            .as_chunks::<4>()
            .0
            .iter()
            .map(|b| f64::from(i32::from_le_bytes(*b)))
            .collect(),
        (data_type::INT32, None) => tensor.int32_data.iter().map(|v| f64::from(*v)).collect(),
        (data_type::FLOAT, Some(raw)) => raw
            .as_chunks::<4>()
            .0
            .iter()
            .map(|b| f64::from(f32::from_le_bytes(*b)))
            .collect(),
        (data_type::FLOAT, None) => tensor.float_data.iter().map(|v| f64::from(*v)).collect(),
        _ => return None,
    })
}

fn constant_attribute(attribute: &AttributeProto) -> Known {
    let numbers: Vec<f64> = match attribute.name.as_deref() {
        Some("value") => return attribute.t.as_ref().map(constant).unwrap_or_default(),
        Some("value_int") => attribute.i.iter().map(|v| *v as f64).collect(),
        Some("value_float") => attribute.f.iter().map(|v| f64::from(*v)).collect(),
        Some("value_ints") => attribute.ints.iter().map(|v| *v as f64).collect(),
        Some("value_floats") => attribute.floats.iter().map(|v| f64::from(*v)).collect(),
        _ => return Known::default(),
    };
    let scalar = matches!(attribute.name.as_deref(), Some("value_int" | "value_float"));
    let shape = if scalar {
        vec![]
    } else {
        vec![numbers.len() as u64]
    };
    Known {
        shape: Some(shape),
        numbers: (numbers.len() <= MOST_NUMBERS).then_some(numbers),
    }
}
