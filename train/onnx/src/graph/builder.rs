//! The network under construction: its values, names and constants, and its encoding.

use std::collections::HashSet;

use prost::Message;
use prost::bytes::Bytes;

use super::encode::{halve, value_info};
use super::shapes::{Dim, GraphError, dims_text, shape_error};
use crate::metadata::{ModelMetadata, Weights};
use crate::proto::{
    AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, StringStringEntryProto,
    TensorProto, data_type,
};

/// Version of the ONNX operator set that is written.
pub const OPSET: i64 = 17;
/// Version of the file format that is written.
pub const IR_VERSION: i64 = 8;
/// What the files name as their producer.
pub const PRODUCER: &str = "strat";

/// A value of the network under construction: an input or the result of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Value(usize);

pub(super) struct Slot {
    pub name: String,
    pub dims: Vec<Dim>,
}

/// The inputs of a node: values by number, initializers by name, and gaps.
pub(super) enum Source {
    Value(Value),
    Constant(String),
    Absent,
}

struct Node {
    name: String,
    op: &'static str,
    inputs: Vec<Source>,
    output: Value,
    attributes: Vec<AttributeProto>,
}

/// Collects a network layer by layer and encodes it as an ONNX file.
///
/// ```
/// use strat_onnx::graph::{Filter, Geometry, GraphBuilder};
///
/// let mut graph = GraphBuilder::new("example");
/// let image = graph.input("image", &["N".into(), 1.into(), 4.into(), 4.into()])?;
/// let filter = Filter { shape: [1, 1, 3, 3], weights: vec![1.0 / 9.0; 9], bias: vec![0.0] };
/// let blurred = graph.conv("blur", image, filter, Geometry::new(1, 1))?;
/// graph.output("blurred", blurred)?;
/// let bytes = graph.finish(None)?;
/// assert!(!bytes.is_empty());
/// # Ok::<(), strat_onnx::graph::GraphError>(())
/// ```
pub struct GraphBuilder {
    name: String,
    values: Vec<Slot>,
    inputs: Vec<Value>,
    outputs: Vec<Value>,
    nodes: Vec<Node>,
    initializers: Vec<TensorProto>,
    names: HashSet<String>,
    pub(super) resize_scales: Option<String>,
    weights: Weights,
}

impl GraphBuilder {
    /// An empty network; the name is informative only.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            values: Vec::new(),
            inputs: Vec::new(),
            outputs: Vec::new(),
            nodes: Vec::new(),
            initializers: Vec::new(),
            names: HashSet::new(),
            resize_scales: None,
            weights: Weights::F32,
        }
    }

    /// Stores the weights of convolutions in this form. Half-precision ones are turned into `f32`
    /// by a `Cast` node each before they are used, so any runtime computes as before; biases stay.
    #[must_use]
    pub fn with_weights(mut self, weights: Weights) -> Self {
        self.weights = weights;
        self
    }

    /// Inferred dimensions of a value; empty for a value of another builder.
    #[must_use]
    pub fn dims(&self, value: Value) -> &[Dim] {
        self.values.get(value.0).map_or(&[], |slot| &slot.dims)
    }

    /// Adds an `f32` input.
    ///
    /// # Errors
    /// The name is empty or taken.
    pub fn input(&mut self, name: &str, dims: &[Dim]) -> Result<Value, GraphError> {
        let value = self.new_value(name, dims.to_vec())?;
        self.inputs.push(value);
        Ok(value)
    }

    /// Declares a value as an output of the network under this name, with inferred dimensions.
    ///
    /// # Errors
    /// The name is empty or taken, or the value is an input or already an output.
    pub fn output(&mut self, name: &str, value: Value) -> Result<(), GraphError> {
        let slot = self.slot(name, value)?;
        if self.inputs.contains(&value) || self.outputs.contains(&value) {
            let problem = format!(
                "the value \"{}\" is an input or an output already; an output needs a layer of its own",
                slot.name
            );
            return Err(shape_error(name, problem));
        }
        // In ONNX an output is a value by its name, so the value takes the output's name.
        if slot.name != name {
            self.take_name(name)?;
            let old = std::mem::replace(&mut self.values[value.0].name, name.to_owned());
            self.names.remove(&old);
        }
        self.outputs.push(value);
        Ok(())
    }

    /// As [`output`](Self::output), with dimensions that replace what could not be inferred.
    ///
    /// # Errors
    /// As [`output`](Self::output), or the dimensions contradict the inferred ones.
    pub fn output_with_dims(
        &mut self,
        name: &str,
        value: Value,
        dims: &[Dim],
    ) -> Result<(), GraphError> {
        let inferred = &self.slot(name, value)?.dims;
        let fits = inferred.len() == dims.len()
            && inferred.iter().zip(dims).all(|pair| match pair {
                (Dim::Fixed(a), Dim::Fixed(b)) => a == b,
                (Dim::Fixed(_), _) => false,
                (Dim::Symbolic(_) | Dim::Unknown, _) => true,
            });
        if !fits {
            return Err(shape_error(
                name,
                format!(
                    "the output is stated as {} but the layers give {}",
                    dims_text(dims),
                    dims_text(inferred)
                ),
            ));
        }
        self.output(name, value)?;
        self.values[value.0].dims = dims.to_vec();
        Ok(())
    }

    /// Number of weights and other constants collected so far.
    #[must_use]
    pub fn parameters(&self) -> u64 {
        let count = |tensor: &TensorProto| tensor.dims.iter().product::<i64>().unsigned_abs();
        self.initializers.iter().map(count).sum()
    }

    /// Encodes the network. The same calls give the same bytes.
    ///
    /// # Errors
    /// The network has no input or no output, or is larger than the format allows.
    pub fn finish(self, metadata: Option<&ModelMetadata>) -> Result<Vec<u8>, GraphError> {
        let version = metadata.and_then(|metadata| metadata.tool_version.clone());
        let props = metadata.map(ModelMetadata::to_props).unwrap_or_default();
        self.finish_with(props, version)
    }

    /// As [`finish`](Self::finish), with properties and a version of the producer.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn finish_with(
        self,
        props: Vec<(String, String)>,
        producer_version: Option<String>,
    ) -> Result<Vec<u8>, GraphError> {
        for (what, list) in [("input", &self.inputs), ("output", &self.outputs)] {
            if list.is_empty() {
                return Err(GraphError::Missing { what });
            }
        }
        let Self {
            name,
            values,
            inputs,
            outputs,
            nodes,
            mut initializers,
            ..
        } = self;
        let casts = match self.weights {
            Weights::F32 => Vec::new(),
            Weights::F16 => initializers.iter_mut().filter_map(halve).collect(),
        };
        let name_of = |value: Value| values[value.0].name.clone();
        let info = |value: &Value| {
            let slot = &values[value.0];
            value_info(&slot.name, &slot.dims)
        };
        let graph = GraphProto {
            input: inputs.iter().map(info).collect(),
            output: outputs.iter().map(info).collect(),
            node: casts
                .into_iter()
                .chain(nodes.into_iter().map(|node| {
                    NodeProto {
                        input: node
                            .inputs
                            .into_iter()
                            .map(|source| match source {
                                Source::Value(value) => name_of(value),
                                Source::Constant(name) => name,
                                Source::Absent => String::new(),
                            })
                            .collect(),
                        output: vec![name_of(node.output)],
                        name: Some(node.name),
                        op_type: Some(node.op.to_owned()),
                        attribute: node.attributes,
                        ..NodeProto::default()
                    }
                }))
                .collect(),
            name: Some(name),
            initializer: initializers,
            ..GraphProto::default()
        };
        let model = ModelProto {
            ir_version: Some(IR_VERSION),
            producer_name: Some(PRODUCER.to_owned()),
            producer_version,
            opset_import: vec![OperatorSetIdProto {
                domain: Some(String::new()),
                version: Some(OPSET),
            }],
            metadata_props: props
                .into_iter()
                .map(|(key, value)| StringStringEntryProto::new(key, value))
                .collect(),
            graph: Some(graph),
            ..ModelProto::default()
        };
        let bytes = model.encoded_len();
        if bytes > i32::MAX as usize {
            return Err(GraphError::TooLarge { bytes });
        }
        Ok(model.encode_to_vec())
    }

    pub(super) fn slot(&self, layer: &str, value: Value) -> Result<&Slot, GraphError> {
        self.values
            .get(value.0)
            .ok_or_else(|| GraphError::ForeignValue {
                layer: layer.to_owned(),
            })
    }

    pub(super) fn image_dims(&self, layer: &str, value: Value) -> Result<[Dim; 4], GraphError> {
        let dims = &self.slot(layer, value)?.dims;
        dims.clone().try_into().map_err(|_| {
            shape_error(
                layer,
                format!(
                    "an image [N, channels, height, width] is needed, not {}",
                    dims_text(dims)
                ),
            )
        })
    }

    fn take_name(&mut self, name: &str) -> Result<(), GraphError> {
        if name.is_empty() {
            return Err(GraphError::EmptyName);
        }
        if !self.names.insert(name.to_owned()) {
            return Err(GraphError::DuplicateName {
                name: name.to_owned(),
            });
        }
        Ok(())
    }

    fn new_value(&mut self, name: &str, dims: Vec<Dim>) -> Result<Value, GraphError> {
        self.take_name(name)?;
        self.values.push(Slot {
            name: name.to_owned(),
            dims,
        });
        Ok(Value(self.values.len() - 1))
    }

    pub(super) fn node(
        &mut self,
        name: &str,
        op: &'static str,
        inputs: Vec<Source>,
        dims: Vec<Dim>,
        attributes: Vec<AttributeProto>,
    ) -> Result<Value, GraphError> {
        let output = self.new_value(name, dims)?;
        self.nodes.push(Node {
            name: name.to_owned(),
            op,
            inputs,
            output,
            attributes,
        });
        Ok(output)
    }

    pub(super) fn constant_f32(
        &mut self,
        name: &str,
        dims: &[usize],
        data: &[f32],
    ) -> Result<String, GraphError> {
        let raw = data.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.constant(name, dims, data_type::FLOAT, raw)
    }

    pub(super) fn constant_i64(&mut self, name: &str, data: &[i64]) -> Result<String, GraphError> {
        let raw = data.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.constant(name, &[data.len()], data_type::INT64, raw)
    }

    fn constant(
        &mut self,
        name: &str,
        dims: &[usize],
        data_type: i32,
        raw: Vec<u8>,
    ) -> Result<String, GraphError> {
        self.take_name(name)?;
        self.initializers.push(TensorProto {
            dims: dims.iter().map(|&size| size as i64).collect(),
            data_type: Some(data_type),
            name: Some(name.to_owned()),
            raw_data: Some(Bytes::from(raw)),
            ..TensorProto::default()
        });
        Ok(name.to_owned())
    }
}
