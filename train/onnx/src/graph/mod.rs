//! Builds the ONNX graph of a convolutional network and encodes it.
//!
//! Operators follow the ONNX specification at opset 17 (IR version 8). Every attribute that a
//! runtime could default is written out: some runtimes refuse a `Conv` without `strides`. Shapes
//! are inferred while building, so a wrong channel count is an error at the call that caused it
//! and not at the first run in some runtime.
//!
//! Only what an encoder-decoder for images needs is here: `f32` values in `NCHW` order. Weights
//! stay inside the file, which the format limits to 2 GiB.

use std::collections::HashSet;
use std::fmt;

use half::f16;
use prost::Message;
use prost::bytes::Bytes;
use serde::Serialize;

use crate::metadata::{ModelMetadata, Weights};
use crate::proto::{
    self, AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, TensorProto,
    TensorShapeProto, TypeProto, ValueInfoProto, attribute_type, data_type, dimension, type_proto,
};

/// Version of the ONNX operator set that is written.
pub const OPSET: i64 = 17;
/// Version of the file format that is written.
pub const IR_VERSION: i64 = 8;
/// What the files name as their producer.
pub const PRODUCER: &str = "strat";

/// The size of a tensor along one axis.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(untagged)]
pub enum Dim {
    /// A known number of elements.
    Fixed(usize),
    /// A size chosen at run time; equal names mean equal sizes.
    Symbolic(String),
    /// A size chosen at run time that has no name.
    Unknown,
}

impl Dim {
    /// The number of elements, where it is known.
    #[must_use]
    pub fn fixed(&self) -> Option<usize> {
        match self {
            Self::Fixed(size) => Some(*size),
            Self::Symbolic(_) | Self::Unknown => None,
        }
    }
}

impl From<usize> for Dim {
    fn from(size: usize) -> Self {
        Self::Fixed(size)
    }
}

impl From<&str> for Dim {
    fn from(name: &str) -> Self {
        Self::Symbolic(name.to_owned())
    }
}

impl fmt::Display for Dim {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fixed(size) => write!(f, "{size}"),
            Self::Symbolic(name) => f.write_str(name),
            Self::Unknown => f.write_str("?"),
        }
    }
}

/// `[N, 3, 256, 512]`, for messages.
#[must_use]
pub fn dims_text(dims: &[Dim]) -> String {
    let parts: Vec<String> = dims.iter().map(Dim::to_string).collect();
    format!("[{}]", parts.join(", "))
}

/// Why a graph could not be built.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum GraphError {
    /// A name was used twice.
    #[error("the name \"{name}\" is used twice in the network; give every layer its own")]
    DuplicateName {
        /// The name in question.
        name: String,
    },
    /// A name was empty.
    #[error("a layer, input or output of the network has an empty name")]
    EmptyName,
    /// The values do not fit the operator.
    #[error("layer \"{layer}\": {problem}")]
    Shape {
        /// The layer that was being added.
        layer: String,
        /// What does not fit, as a sentence part.
        problem: String,
    },
    /// The value came from another builder.
    #[error("layer \"{layer}\" uses a value of another network")]
    ForeignValue {
        /// The layer that was being added.
        layer: String,
    },
    /// Nothing would be computed.
    #[error("the network has no {what}")]
    Missing {
        /// `input` or `output`.
        what: &'static str,
    },
    /// The encoded model would not be readable by other programs.
    #[error(
        "the model would take {bytes} bytes; an ONNX file with its weights inside is limited to 2 GiB"
    )]
    TooLarge {
        /// Size of the encoded model.
        bytes: usize,
    },
}

/// A value of the network under construction: an input or the result of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Value(usize);

/// Weights of a convolution.
#[derive(Clone, Debug, PartialEq)]
pub struct Filter {
    /// `[out, in / group, height, width]` for a convolution,
    /// `[in, out / group, height, width]` for a transposed one.
    pub shape: [usize; 4],
    /// Row-major elements.
    pub weights: Vec<f32>,
    /// One per output channel, or empty for no bias.
    pub bias: Vec<f32>,
}

/// How a window moves over an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Geometry {
    /// Vertical and horizontal step.
    pub stride: [usize; 2],
    /// Rows and columns added: top, left, bottom, right. For a transposed convolution, removed
    /// from its result.
    pub pads: [usize; 4],
    /// Vertical and horizontal distance between taps.
    pub dilation: [usize; 2],
    /// Number of groups the channels are divided into (convolutions only).
    pub group: usize,
}

impl Geometry {
    /// The same stride both ways and the same padding on all four sides.
    #[must_use]
    pub const fn new(stride: usize, padding: usize) -> Self {
        Self {
            stride: [stride; 2],
            pads: [padding; 4],
            dilation: [1; 2],
            group: 1,
        }
    }
}

struct Slot {
    name: String,
    dims: Vec<Dim>,
}

/// The inputs of a node: values by number, initializers by name, and gaps.
enum Source {
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
    resize_scales: Option<String>,
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

    /// `Conv`: `[N, in, h, w]` to `[N, out, h', w']` with
    /// `h' = (h + top + bottom - dilation * (kernel - 1) - 1) / stride + 1`, rounded down.
    ///
    /// # Errors
    /// The name is taken, or filter, geometry and input do not fit each other.
    pub fn conv(
        &mut self,
        name: &str,
        input: Value,
        filter: Filter,
        geometry: Geometry,
    ) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        check_filter(name, &filter, &geometry)?;
        let [out, in_per_group, kernel_h, kernel_w] = filter.shape;
        check_channels(name, &image[1], in_per_group * geometry.group)?;
        if !out.is_multiple_of(geometry.group) {
            return Err(shape_error(
                name,
                format!(
                    "{out} output channels cannot be divided into {} groups",
                    geometry.group
                ),
            ));
        }
        check_bias(name, &filter, out)?;
        let kernel = [kernel_h, kernel_w];
        let [height, width] = window_dims(name, &image, kernel, &geometry)?;
        let dims = vec![image[0].clone(), out.into(), height, width];
        self.convolution(name, "Conv", input, filter, geometry, dims)
    }

    /// `ConvTranspose`: `[N, in, h, w]` to `[N, out, h', w']` with
    /// `h' = (h - 1) * stride - top - bottom + dilation * (kernel - 1) + 1`. Kernel 4, stride 2,
    /// padding 1 doubles the size exactly.
    ///
    /// # Errors
    /// The name is taken, or filter, geometry and input do not fit each other.
    pub fn conv_transpose(
        &mut self,
        name: &str,
        input: Value,
        filter: Filter,
        geometry: Geometry,
    ) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        check_filter(name, &filter, &geometry)?;
        let [channels, out_per_group, kernel_h, kernel_w] = filter.shape;
        check_channels(name, &image[1], channels)?;
        if !channels.is_multiple_of(geometry.group) {
            return Err(shape_error(
                name,
                format!(
                    "{channels} input channels cannot be divided into {} groups",
                    geometry.group
                ),
            ));
        }
        let out = out_per_group * geometry.group;
        check_bias(name, &filter, out)?;
        let size = |axis: usize, kernel: usize| -> Result<Dim, GraphError> {
            let Some(size) = image[axis + 2].fixed() else {
                return Ok(Dim::Unknown);
            };
            let full = size.saturating_sub(1) * geometry.stride[axis]
                + geometry.dilation[axis] * (kernel - 1)
                + 1;
            match full.checked_sub(geometry.pads[axis] + geometry.pads[axis + 2]) {
                Some(size) if size > 0 => Ok(size.into()),
                _ => Err(shape_error(
                    name,
                    "the padding removes the whole result".into(),
                )),
            }
        };
        let dims = vec![
            image[0].clone(),
            out.into(),
            size(0, kernel_h)?,
            size(1, kernel_w)?,
        ];
        self.convolution(name, "ConvTranspose", input, filter, geometry, dims)
    }

    /// `MaxPool` over a window; padded pixels never win (they count as minus infinity, not zero).
    /// The group of the geometry is ignored. Rounds the size down.
    ///
    /// # Errors
    /// The name is taken or the window does not fit the input.
    pub fn max_pool(
        &mut self,
        name: &str,
        input: Value,
        kernel: usize,
        geometry: Geometry,
    ) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        let kernel = [kernel; 2];
        if geometry.pads.iter().any(|&pad| pad >= kernel[0]) {
            return Err(shape_error(
                name,
                "the padding must be smaller than the window".into(),
            ));
        }
        let [height, width] = window_dims(name, &image, kernel, &geometry)?;
        let dims = vec![image[0].clone(), image[1].clone(), height, width];
        let mut attributes = window_attributes(kernel, &geometry);
        attributes.push(attribute_int("ceil_mode", 0));
        self.node(
            name,
            "MaxPool",
            vec![Source::Value(input)],
            dims,
            attributes,
        )
    }

    /// `Pad` with zeros: rows and columns added at top, left, bottom and right.
    ///
    /// # Errors
    /// The name is taken or the input is not an image.
    pub fn pad_zero(
        &mut self,
        name: &str,
        input: Value,
        pads: [usize; 4],
    ) -> Result<Value, GraphError> {
        let mut dims = self.image_dims(name, input)?.to_vec();
        for axis in [0, 1] {
            if let Dim::Fixed(size) = &mut dims[axis + 2] {
                *size += pads[axis] + pads[axis + 2];
            } else if pads[axis] + pads[axis + 2] > 0 {
                dims[axis + 2] = Dim::Unknown;
            }
        }
        let [top, left, bottom, right] = pads.map(|pad| pad as i64);
        let amounts = [0, 0, top, left, 0, 0, bottom, right];
        let pads = self.constant_i64(&format!("{name}.pads"), &amounts)?;
        let zero = self.constant_f32(&format!("{name}.value"), &[], &[0.0])?;
        let inputs = vec![
            Source::Value(input),
            Source::Constant(pads),
            Source::Constant(zero),
        ];
        self.node(
            name,
            "Pad",
            inputs,
            dims,
            vec![attribute_string("mode", "constant")],
        )
    }

    /// `Resize` by the factor 2 in both directions, each pixel becoming a block of four.
    ///
    /// # Errors
    /// The name is taken or the input is not an image.
    pub fn nearest_x2(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        let double = |dim: &Dim| {
            dim.fixed()
                .map_or(Dim::Unknown, |size| Dim::Fixed(size * 2))
        };
        let dims = vec![
            image[0].clone(),
            image[1].clone(),
            double(&image[2]),
            double(&image[3]),
        ];
        let scales = match &self.resize_scales {
            Some(scales) => scales.clone(),
            None => {
                let scales = self.constant_f32("resize_x2.scales", &[4], &[1.0, 1.0, 2.0, 2.0])?;
                self.resize_scales = Some(scales.clone());
                scales
            }
        };
        let attributes = vec![
            attribute_string("mode", "nearest"),
            attribute_string("coordinate_transformation_mode", "asymmetric"),
            attribute_string("nearest_mode", "floor"),
        ];
        let inputs = vec![
            Source::Value(input),
            Source::Absent,
            Source::Constant(scales),
        ];
        self.node(name, "Resize", inputs, dims, attributes)
    }

    /// `Elu` with alpha 1: `x` above zero, `exp(x) - 1` below.
    ///
    /// # Errors
    /// The name is taken.
    pub fn elu(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        self.unary(name, "Elu", input, vec![attribute_float("alpha", 1.0)])
    }

    /// `Relu`: `max(x, 0)`.
    ///
    /// # Errors
    /// The name is taken.
    pub fn relu(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        self.unary(name, "Relu", input, Vec::new())
    }

    /// `Sigmoid`: `1 / (1 + exp(-x))`.
    ///
    /// # Errors
    /// The name is taken.
    pub fn sigmoid(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        self.unary(name, "Sigmoid", input, Vec::new())
    }

    /// `Mul` of every element by a constant.
    ///
    /// # Errors
    /// The name is taken.
    pub fn scale(&mut self, name: &str, input: Value, factor: f32) -> Result<Value, GraphError> {
        let dims = self.slot(name, input)?.dims.clone();
        let factor = self.constant_f32(&format!("{name}.factor"), &[], &[factor])?;
        let inputs = vec![Source::Value(input), Source::Constant(factor)];
        self.node(name, "Mul", inputs, dims, Vec::new())
    }

    /// `Max` of every element and a constant.
    ///
    /// # Errors
    /// The name is taken.
    pub fn at_least(
        &mut self,
        name: &str,
        input: Value,
        minimum: f32,
    ) -> Result<Value, GraphError> {
        let dims = self.slot(name, input)?.dims.clone();
        let minimum = self.constant_f32(&format!("{name}.minimum"), &[], &[minimum])?;
        let inputs = vec![Source::Value(input), Source::Constant(minimum)];
        self.node(name, "Max", inputs, dims, Vec::new())
    }

    /// `Add` of two values of the same shape.
    ///
    /// # Errors
    /// The name is taken or the shapes differ.
    pub fn add(&mut self, name: &str, left: Value, right: Value) -> Result<Value, GraphError> {
        let (a, b) = (&self.slot(name, left)?.dims, &self.slot(name, right)?.dims);
        let Some(dims) = merge_dims(a, b, None) else {
            return Err(shape_error(
                name,
                format!("{} and {} cannot be added", dims_text(a), dims_text(b)),
            ));
        };
        let inputs = vec![Source::Value(left), Source::Value(right)];
        self.node(name, "Add", inputs, dims, Vec::new())
    }

    /// `Concat` along an axis (1 = channels); all other dimensions must agree.
    ///
    /// # Errors
    /// The name is taken, nothing was given, or the shapes do not agree.
    pub fn concat(
        &mut self,
        name: &str,
        values: &[Value],
        axis: usize,
    ) -> Result<Value, GraphError> {
        let Some((first, rest)) = values.split_first() else {
            return Err(shape_error(name, "there is nothing to concatenate".into()));
        };
        let mut dims = self.slot(name, *first)?.dims.clone();
        if axis >= dims.len() {
            return Err(shape_error(
                name,
                format!("{} has no axis {axis}", dims_text(&dims)),
            ));
        }
        for value in rest {
            let next = &self.slot(name, *value)?.dims;
            let Some(mut merged) = merge_dims(&dims, next, Some(axis)) else {
                return Err(shape_error(
                    name,
                    format!(
                        "{} and {} cannot be joined along axis {axis}",
                        dims_text(&dims),
                        dims_text(next)
                    ),
                ));
            };
            merged[axis] = match (dims[axis].fixed(), next[axis].fixed()) {
                (Some(a), Some(b)) => Dim::Fixed(a + b),
                _ => Dim::Unknown,
            };
            dims = merged;
        }
        let inputs = values.iter().map(|value| Source::Value(*value)).collect();
        let attributes = vec![attribute_int("axis", axis as i64)];
        self.node(name, "Concat", inputs, dims, attributes)
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
            producer_version: metadata.and_then(|metadata| metadata.tool_version.clone()),
            opset_import: vec![OperatorSetIdProto {
                domain: Some(String::new()),
                version: Some(OPSET),
            }],
            metadata_props: metadata.map(ModelMetadata::to_entries).unwrap_or_default(),
            graph: Some(graph),
            ..ModelProto::default()
        };
        let bytes = model.encoded_len();
        if bytes > i32::MAX as usize {
            return Err(GraphError::TooLarge { bytes });
        }
        Ok(model.encode_to_vec())
    }

    fn slot(&self, layer: &str, value: Value) -> Result<&Slot, GraphError> {
        self.values
            .get(value.0)
            .ok_or_else(|| GraphError::ForeignValue {
                layer: layer.to_owned(),
            })
    }

    fn image_dims(&self, layer: &str, value: Value) -> Result<[Dim; 4], GraphError> {
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

    fn node(
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

    fn unary(
        &mut self,
        name: &str,
        op: &'static str,
        input: Value,
        attributes: Vec<AttributeProto>,
    ) -> Result<Value, GraphError> {
        let dims = self.slot(name, input)?.dims.clone();
        self.node(name, op, vec![Source::Value(input)], dims, attributes)
    }

    fn convolution(
        &mut self,
        name: &str,
        op: &'static str,
        input: Value,
        filter: Filter,
        geometry: Geometry,
        dims: Vec<Dim>,
    ) -> Result<Value, GraphError> {
        let kernel = [filter.shape[2], filter.shape[3]];
        let weights =
            self.constant_f32(&format!("{name}.weight"), &filter.shape, &filter.weights)?;
        let mut inputs = vec![Source::Value(input), Source::Constant(weights)];
        if !filter.bias.is_empty() {
            let bias = format!("{name}.bias");
            let bias = self.constant_f32(&bias, &[filter.bias.len()], &filter.bias)?;
            inputs.push(Source::Constant(bias));
        }
        let mut attributes = window_attributes(kernel, &geometry);
        attributes.push(attribute_int("group", geometry.group as i64));
        self.node(name, op, inputs, dims, attributes)
    }

    fn constant_f32(
        &mut self,
        name: &str,
        dims: &[usize],
        data: &[f32],
    ) -> Result<String, GraphError> {
        let raw = data.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.constant(name, dims, data_type::FLOAT, raw)
    }

    fn constant_i64(&mut self, name: &str, data: &[i64]) -> Result<String, GraphError> {
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

/// Rounds a filter to half precision under another name and returns the node that gives it back
/// under its own; nothing for other constants.
fn halve(tensor: &mut TensorProto) -> Option<NodeProto> {
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

fn shape_error(layer: &str, problem: String) -> GraphError {
    GraphError::Shape {
        layer: layer.to_owned(),
        problem,
    }
}

fn check_filter(layer: &str, filter: &Filter, geometry: &Geometry) -> Result<(), GraphError> {
    let shape = filter.shape;
    if shape.contains(&0) || geometry.group == 0 {
        return Err(shape_error(
            layer,
            "filter sizes and group must be at least 1".into(),
        ));
    }
    if geometry.stride.contains(&0) || geometry.dilation.contains(&0) {
        return Err(shape_error(
            layer,
            "stride and dilation must be at least 1".into(),
        ));
    }
    let expected: usize = shape.iter().product();
    if filter.weights.len() != expected {
        return Err(shape_error(
            layer,
            format!(
                "a filter of shape {shape:?} needs {expected} weights, got {}",
                filter.weights.len()
            ),
        ));
    }
    Ok(())
}

fn check_channels(layer: &str, found: &Dim, expected: usize) -> Result<(), GraphError> {
    match found.fixed() {
        Some(found) if found != expected => Err(shape_error(
            layer,
            format!("the filter is for {expected} channels, its input has {found}"),
        )),
        _ => Ok(()),
    }
}

fn check_bias(layer: &str, filter: &Filter, channels: usize) -> Result<(), GraphError> {
    if filter.bias.is_empty() || filter.bias.len() == channels {
        return Ok(());
    }
    Err(shape_error(
        layer,
        format!(
            "{channels} output channels need as many biases, got {}",
            filter.bias.len()
        ),
    ))
}

/// Height and width after a window (convolution or pool) has moved over an image.
fn window_dims(
    layer: &str,
    image: &[Dim; 4],
    kernel: [usize; 2],
    geometry: &Geometry,
) -> Result<[Dim; 2], GraphError> {
    if geometry.stride.contains(&0) || geometry.dilation.contains(&0) || kernel.contains(&0) {
        return Err(shape_error(
            layer,
            "window, stride and dilation must be at least 1".into(),
        ));
    }
    let size = |axis: usize| -> Result<Dim, GraphError> {
        let Some(size) = image[axis + 2].fixed() else {
            // A window that keeps every size keeps the symbol too.
            let padding = geometry.pads[axis] + geometry.pads[axis + 2];
            let keeps = geometry.stride[axis] == 1
                && padding == geometry.dilation[axis] * (kernel[axis] - 1);
            return Ok(if keeps {
                image[axis + 2].clone()
            } else {
                Dim::Unknown
            });
        };
        let padded = size + geometry.pads[axis] + geometry.pads[axis + 2];
        let reach = geometry.dilation[axis] * (kernel[axis] - 1) + 1;
        match padded.checked_sub(reach) {
            Some(rest) => Ok((rest / geometry.stride[axis] + 1).into()),
            None => Err(shape_error(
                layer,
                format!("a window of {reach} does not fit into {padded} padded pixels"),
            )),
        }
    };
    Ok([size(0)?, size(1)?])
}

/// What is known from both shapes; `None` where they contradict each other outside `free_axis`.
fn merge_dims(a: &[Dim], b: &[Dim], free_axis: Option<usize>) -> Option<Vec<Dim>> {
    if a.len() != b.len() {
        return None;
    }
    let merge = |(axis, (a, b)): (usize, (&Dim, &Dim))| match (a, b) {
        _ if Some(axis) == free_axis => Some(Dim::Unknown),
        (Dim::Fixed(x), Dim::Fixed(y)) => (x == y).then_some(a.clone()),
        (Dim::Fixed(_), _) | (Dim::Symbolic(_), Dim::Symbolic(_) | Dim::Unknown) => Some(a.clone()),
        (_, _) => Some(b.clone()),
    };
    a.iter().zip(b).enumerate().map(merge).collect()
}

fn window_attributes(kernel: [usize; 2], geometry: &Geometry) -> Vec<AttributeProto> {
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

fn attribute_int(name: &str, value: i64) -> AttributeProto {
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

fn attribute_float(name: &str, value: f32) -> AttributeProto {
    AttributeProto {
        f: Some(value),
        ..attribute(name, attribute_type::FLOAT)
    }
}

fn attribute_string(name: &str, value: &str) -> AttributeProto {
    AttributeProto {
        s: Some(Bytes::copy_from_slice(value.as_bytes())),
        ..attribute(name, attribute_type::STRING)
    }
}

fn value_info(name: &str, dims: &[Dim]) -> ValueInfoProto {
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
