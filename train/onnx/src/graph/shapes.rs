//! Sizes of values and what a layer demands of them.

use std::fmt;

use serde::Serialize;

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

pub(super) fn shape_error(layer: &str, problem: String) -> GraphError {
    GraphError::Shape {
        layer: layer.to_owned(),
        problem,
    }
}

pub(super) fn check_filter(
    layer: &str,
    filter: &Filter,
    geometry: &Geometry,
) -> Result<(), GraphError> {
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

pub(super) fn check_channels(layer: &str, found: &Dim, expected: usize) -> Result<(), GraphError> {
    match found.fixed() {
        Some(found) if found != expected => Err(shape_error(
            layer,
            format!("the filter is for {expected} channels, its input has {found}"),
        )),
        _ => Ok(()),
    }
}

pub(super) fn check_bias(layer: &str, filter: &Filter, channels: usize) -> Result<(), GraphError> {
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
pub(super) fn window_dims(
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
pub(super) fn merge_dims(a: &[Dim], b: &[Dim], free_axis: Option<usize>) -> Option<Vec<Dim>> {
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
