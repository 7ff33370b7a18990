//! What an ONNX file says about its model.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::graph::Dim;
use crate::metadata::{DiscriminatorMetadata, ModelMetadata, Reading};
use crate::proto::{ValueInfoProto, data_type, dimension, type_proto};

/// Type of a tensor's elements, as numbered by ONNX.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ElementType(pub i32);

impl ElementType {
    /// 32-bit floating point.
    pub const F32: Self = Self(data_type::FLOAT);
    /// 16-bit floating point.
    pub const F16: Self = Self(data_type::FLOAT16);
    /// 8-bit unsigned integer.
    pub const U8: Self = Self(data_type::UINT8);

    /// Bits of one element where they are a fixed number.
    pub(super) const fn bits(self) -> Option<u64> {
        Some(match self.0 {
            data_type::FLOAT | data_type::INT32 | data_type::UINT32 => 32,
            data_type::UINT8 | data_type::INT8 | data_type::BOOL | 17..=20 | 24 => 8,
            data_type::UINT16 | data_type::INT16 | data_type::FLOAT16 | data_type::BFLOAT16 => 16,
            data_type::INT64 | data_type::DOUBLE | data_type::UINT64 | 14 => 64,
            15 => 128,
            21..=23 => 4,
            25 | 26 => 2,
            _ => return None,
        })
    }
}

impl fmt::Display for ElementType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            data_type::FLOAT => "f32",
            data_type::UINT8 => "u8",
            data_type::INT8 => "i8",
            data_type::UINT16 => "u16",
            data_type::INT16 => "i16",
            data_type::INT32 => "i32",
            data_type::INT64 => "i64",
            data_type::STRING => "string",
            data_type::BOOL => "bool",
            data_type::FLOAT16 => "f16",
            data_type::DOUBLE => "f64",
            data_type::UINT32 => "u32",
            data_type::UINT64 => "u64",
            data_type::BFLOAT16 => "bf16",
            other => return write!(f, "ONNX type {other}"),
        })
    }
}

impl Serialize for ElementType {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Name, element type and dimensions of an input or output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TensorInfo {
    /// Name to feed or fetch it by.
    pub name: String,
    /// Element type; `None` for what is no tensor (a sequence, a map).
    pub element: Option<ElementType>,
    /// Dimensions; `None` when not even their number is known.
    pub dims: Option<Vec<Dim>>,
}

/// What an ONNX file says about its model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelInfo {
    /// Inputs that must be fed; initializers that older files list as inputs are left out.
    pub inputs: Vec<TensorInfo>,
    /// Outputs in order.
    pub outputs: Vec<TensorInfo>,
    /// Version of the file format.
    pub ir_version: i64,
    /// Version of ONNX's own operator set, if the model imports it.
    pub opset: Option<i64>,
    /// Versions of other operator sets by domain.
    pub other_opsets: BTreeMap<String, i64>,
    /// Program that wrote the file.
    pub producer: Option<String>,
    /// Version of that program.
    pub producer_version: Option<String>,
    /// How often each operator occurs, subgraphs and functions included.
    pub operators: BTreeMap<String, u64>,
    /// Number of elements in the main graph's initializers.
    pub parameters: u64,
    /// All string properties of the file.
    pub properties: Vec<(String, String)>,
    /// What this project's own properties say, if there are any.
    pub description: Reading,
    /// Files beside the model that hold weights, relative to its folder with `/` between parts.
    pub external_files: BTreeSet<String>,
}

impl ModelInfo {
    /// The description by this project, if the file has a usable one.
    #[must_use]
    pub const fn metadata(&self) -> Option<&ModelMetadata> {
        self.description.metadata.as_ref()
    }

    /// What the file of a discriminator says of itself; `None` where it is another model.
    ///
    /// # Errors
    /// A sentence part: which value is missing or wrong.
    pub fn discriminator(&self) -> Result<Option<DiscriminatorMetadata>, String> {
        let properties = self.properties.iter();
        DiscriminatorMetadata::from_props(
            properties.map(|(key, value)| (key.as_str(), value.as_str())),
        )
    }
}

/// A model file that has been read and accepted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelFile {
    /// The path as it was given.
    pub path: PathBuf,
    /// Size of the file in bytes, external data not counted.
    pub bytes: u64,
    /// BLAKE3 of the file in hexadecimal. With external data: BLAKE3 over the digest of the file
    /// followed by those of the external files in order of their names.
    pub blake3: String,
    /// What the file says.
    pub info: ModelInfo,
}

pub(super) fn tensor_info(value: &ValueInfoProto) -> TensorInfo {
    let name = value.name.clone().unwrap_or_default();
    let kind = value.r#type.as_ref().and_then(|kind| kind.value.as_ref());
    let Some(type_proto::Value::TensorType(tensor)) = kind else {
        return TensorInfo {
            name,
            element: None,
            dims: None,
        };
    };
    let dims = tensor.shape.as_ref().map(|shape| {
        let dim = |value: &Option<dimension::Value>| match value {
            Some(dimension::Value::DimValue(size)) => {
                usize::try_from(*size).map_or(Dim::Unknown, Dim::Fixed)
            }
            Some(dimension::Value::DimParam(name)) if !name.is_empty() => {
                Dim::Symbolic(name.clone())
            }
            Some(dimension::Value::DimParam(_)) | None => Dim::Unknown,
        };
        shape.dim.iter().map(|entry| dim(&entry.value)).collect()
    });
    TensorInfo {
        name,
        element: tensor.elem_type.map(ElementType),
        dims,
    }
}
