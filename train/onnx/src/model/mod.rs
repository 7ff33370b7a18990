//! Reads an ONNX file's description and refuses files that would harm a runtime.
//!
//! Everything is judged from the decoded protobuf, before a runtime sees the file. That gives the
//! same sentences whatever runtime follows, and stops files that crash or hang one: a convolution
//! with a group, stride or dilation below 1 (ONNX Runtime 1.31 divides by it), constants whose
//! length contradicts their shape, external data outside the model's folder, and bytes that are no
//! well-formed protobuf (rten 0.27 can loop on them). It does not prove a model harmless: one that
//! asks for more memory than there is can still end the process, so models from strangers belong
//! in a process of their own.
//!
//! Operators are counted but not interpreted; any opset and any operator is accepted here.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io;
use std::path::{Component, Path, PathBuf};

use prost::Message;
use prost::bytes::Bytes;
use serde::Serialize;

use crate::graph::Dim;
use crate::metadata::{ModelMetadata, Reading};
use crate::proto::{
    AttributeProto, DATA_LOCATION_EXTERNAL, GraphProto, ModelProto, NodeProto, TensorProto,
    ValueInfoProto, data_type, dimension, type_proto,
};

/// Protobuf's limit for one message.
const LARGEST_FILE: u64 = i32::MAX as u64;

/// Why a model file was refused. `path` is the name of the file as it was given.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file system refused.
    #[error("cannot read the model {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A folder was given.
    #[error("{} is a folder; a model is one .onnx file", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// A pipe or device was given, which may never end.
    #[error("{} is not a regular file; a model is one .onnx file on disk", path.display())]
    NotAFile {
        /// The path.
        path: PathBuf,
    },
    /// No byte in the file.
    #[error("the model {} is empty; copy or export it again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Larger than the format allows.
    #[error(
        "the model {} has {bytes} bytes; an ONNX file is limited to 2 GiB, larger weights go into external data",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// The placeholder that git-lfs leaves for a file it has not fetched.
    #[error(
        "{} is a git-lfs pointer and not the model itself; run `git lfs pull` in its repository",
        path.display()
    )]
    GitLfsPointer {
        /// The file.
        path: PathBuf,
    },
    /// Something else by its first bytes.
    #[error("{} is not an ONNX model: it looks like {kind}", path.display())]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// What it looks like.
        kind: &'static str,
    },
    /// The protobuf is malformed.
    #[error(
        "{} is not a complete ONNX model (truncated, damaged, or another kind of file): {reason}",
        path.display()
    )]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where decoding stopped or what is missing.
        reason: String,
    },
    /// Decoded, but no runtime should be given it.
    #[error("the model {} is refused: {problem}", path.display())]
    Unsafe {
        /// The file.
        path: PathBuf,
        /// What is wrong, naming the node or tensor.
        problem: String,
    },
    /// A part of the weights cannot be had.
    #[error("the model {} keeps weights in other files: {problem}", path.display())]
    ExternalData {
        /// The file.
        path: PathBuf,
        /// What is wrong, naming the tensor and file.
        problem: String,
    },
}

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
    const fn bits(self) -> Option<u64> {
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

/// Reads, checks and describes a model file.
///
/// # Errors
/// The file cannot be read, is no complete ONNX model, or is refused (see the module's header).
pub fn read(path: impl AsRef<Path>) -> Result<ModelFile, ReadError> {
    read_with_bytes(path.as_ref()).map(|(file, _)| file)
}

/// As [`read`], together with the bytes that were judged.
///
/// # Errors
/// As [`read`].
pub fn read_with_bytes(path: &Path) -> Result<(ModelFile, Vec<u8>), ReadError> {
    let io_error = |source| ReadError::Io {
        path: path.to_owned(),
        source,
    };
    let status = std::fs::metadata(path).map_err(io_error)?;
    if status.is_dir() {
        return Err(ReadError::Folder {
            path: path.to_owned(),
        });
    }
    if !status.is_file() {
        return Err(ReadError::NotAFile {
            path: path.to_owned(),
        });
    }
    if status.len() > LARGEST_FILE {
        return Err(ReadError::TooLarge {
            path: path.to_owned(),
            bytes: status.len(),
        });
    }
    let bytes = Bytes::from(std::fs::read(path).map_err(io_error)?);
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let info = inspect_bytes(bytes.clone(), path, Some(folder))?;
    let mut digest = blake3::hash(&bytes);
    if !info.external_files.is_empty() {
        let mut hasher = blake3::Hasher::new();
        hasher.update(digest.as_bytes());
        for name in &info.external_files {
            let mut part = blake3::Hasher::new();
            let file = fs_err::File::open(folder.join(name)).map_err(io_error)?;
            part.update_reader(file).map_err(io_error)?;
            hasher.update(part.finalize().as_bytes());
        }
        digest = hasher.finalize();
    }
    let file = ModelFile {
        path: path.to_owned(),
        bytes: bytes.len() as u64,
        blake3: digest.to_hex().to_string(),
        info,
    };
    Ok((file, Vec::from(bytes)))
}

/// Checks and describes a model in memory; `name` stands for the file in messages. Weights in
/// other files are refused.
///
/// # Errors
/// As [`read`].
pub fn inspect(bytes: &[u8], name: &str) -> Result<ModelInfo, ReadError> {
    inspect_bytes(Bytes::copy_from_slice(bytes), Path::new(name), None)
}

/// As [`inspect`], giving the bytes back: a model is large enough to mind a copy.
pub(crate) fn inspect_owned(bytes: Vec<u8>, name: &str) -> Result<(ModelInfo, Vec<u8>), ReadError> {
    let bytes = Bytes::from(bytes);
    let info = inspect_bytes(bytes.clone(), Path::new(name), None)?;
    Ok((info, Vec::from(bytes)))
}

/// Replaces this project's properties in an encoded model, keeping everything else.
///
/// The parity of a model is known only after the file has been written and run once; this puts it
/// in without building the graph again.
///
/// # Errors
/// The bytes are no model that [`inspect`] accepts.
pub fn with_metadata(bytes: &[u8], metadata: &ModelMetadata) -> Result<Vec<u8>, ReadError> {
    let name = Path::new("in memory");
    let bytes = Bytes::copy_from_slice(bytes);
    inspect_bytes(bytes.clone(), name, None)?;
    let mut model =
        ModelProto::decode(bytes).map_err(|error| malformed(name, error.to_string()))?;
    model
        .metadata_props
        .retain(|entry| !ModelMetadata::is_own_key(entry.key.as_deref().unwrap_or_default()));
    model.metadata_props.extend(metadata.to_entries());
    Ok(model.encode_to_vec())
}

fn malformed(path: &Path, reason: impl Into<String>) -> ReadError {
    ReadError::Malformed {
        path: path.to_owned(),
        reason: reason.into(),
    }
}

/// Kinds of file that are met in place of a model.
fn check_first_bytes(bytes: &[u8], path: &Path) -> Result<(), ReadError> {
    if bytes.is_empty() {
        return Err(ReadError::Empty {
            path: path.to_owned(),
        });
    }
    if bytes.starts_with(b"version https://git-lfs") {
        return Err(ReadError::GitLfsPointer {
            path: path.to_owned(),
        });
    }
    let start = &bytes[..bytes.len().min(512)];
    let text = start.trim_ascii_start().to_ascii_lowercase();
    let kind = if text.starts_with(b"<!doctype") || text.starts_with(b"<html") {
        "a web page (perhaps a failed download)"
    } else if text.starts_with(b"<?xml") {
        "an XML document (perhaps a failed download)"
    } else if start.starts_with(b"PK\x03\x04") {
        "a zip archive or a PyTorch checkpoint"
    } else if start.starts_with(b"\x1f\x8b") {
        "a gzip archive; unpack it first"
    } else if start.starts_with(b"\x80\x02") || start.starts_with(b"\x80\x04") {
        "a Python pickle"
    } else if start.starts_with(b"\x89HDF") {
        "an HDF5 file"
    } else if start.get(4..8) == Some(b"TFL3") {
        "a TensorFlow Lite model"
    } else if start.get(4..8) == Some(b"ORTM") {
        "a model in ONNX Runtime's own format; the .onnx file it was made from is needed"
    } else if start.iter().all(|&byte| byte == 0) {
        "a file of zeros (an interrupted copy)"
    } else {
        return Ok(());
    };
    Err(ReadError::OtherKind {
        path: path.to_owned(),
        kind,
    })
}

fn inspect_bytes(bytes: Bytes, path: &Path, folder: Option<&Path>) -> Result<ModelInfo, ReadError> {
    check_first_bytes(&bytes, path)?;
    let model = ModelProto::decode(bytes).map_err(|error| malformed(path, error.to_string()))?;
    let Some(ir_version) = model.ir_version else {
        return Err(malformed(path, "the version of the format is missing"));
    };
    let Some(graph) = &model.graph else {
        return Err(malformed(path, "it holds no graph"));
    };
    if model.opset_import.is_empty() {
        return Err(malformed(path, "it states no operator set"));
    }

    let mut walk = Walk {
        path,
        folder,
        operators: BTreeMap::new(),
        external_files: BTreeSet::new(),
    };
    walk.graph(graph)?;
    for function in &model.functions {
        for attribute in &function.attribute_proto {
            walk.attribute(attribute, "a function")?;
        }
        for node in &function.node {
            walk.node(node)?;
        }
    }
    let Walk {
        operators,
        external_files,
        ..
    } = walk;

    let constants: BTreeSet<&str> = graph
        .initializer
        .iter()
        .filter_map(|tensor| tensor.name.as_deref())
        .collect();
    let inputs: Vec<TensorInfo> = graph
        .input
        .iter()
        .filter(|value| !constants.contains(value.name.as_deref().unwrap_or_default()))
        .map(tensor_info)
        .collect();
    let outputs: Vec<TensorInfo> = graph.output.iter().map(tensor_info).collect();
    if outputs.is_empty() {
        return Err(malformed(path, "its graph has no output"));
    }
    if inputs
        .iter()
        .chain(&outputs)
        .any(|tensor| tensor.name.is_empty())
    {
        return Err(malformed(path, "an input or output has no name"));
    }

    let mut opset = None;
    let mut other_opsets = BTreeMap::new();
    for entry in &model.opset_import {
        let version = entry.version.unwrap_or(0);
        match entry.domain.as_deref().unwrap_or_default() {
            "" | "ai.onnx" => opset = Some(version),
            domain => {
                other_opsets.insert(domain.to_owned(), version);
            }
        }
    }
    let properties: Vec<(String, String)> = model
        .metadata_props
        .iter()
        .map(|entry| {
            (
                entry.key.clone().unwrap_or_default(),
                entry.value.clone().unwrap_or_default(),
            )
        })
        .collect();
    let pairs = properties
        .iter()
        .map(|(key, value)| (key.as_str(), value.as_str()));
    let parameters = graph
        .initializer
        .iter()
        .filter_map(|tensor| elements(&tensor.dims))
        .sum();
    Ok(ModelInfo {
        inputs,
        outputs,
        ir_version,
        opset,
        other_opsets,
        producer: model.producer_name.clone(),
        producer_version: model.producer_version.clone(),
        operators,
        parameters,
        description: ModelMetadata::from_props(pairs),
        properties,
        external_files,
    })
}

fn tensor_info(value: &ValueInfoProto) -> TensorInfo {
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

/// Number of elements of a shape; `None` for negative sizes or more than can be counted.
fn elements(dims: &[i64]) -> Option<u64> {
    dims.iter().try_fold(1_u64, |product, &size| {
        product.checked_mul(u64::try_from(size).ok()?)
    })
}

/// Goes through all nodes and constants of a model. The depth is limited by prost, which refuses
/// messages nested more than 100 deep.
struct Walk<'a> {
    path: &'a Path,
    folder: Option<&'a Path>,
    operators: BTreeMap<String, u64>,
    external_files: BTreeSet<String>,
}

impl Walk<'_> {
    fn refuse(&self, problem: String) -> ReadError {
        ReadError::Unsafe {
            path: self.path.to_owned(),
            problem,
        }
    }

    fn graph(&mut self, graph: &GraphProto) -> Result<(), ReadError> {
        for tensor in &graph.initializer {
            self.tensor(tensor)?;
        }
        for sparse in &graph.sparse_initializer {
            for tensor in [&sparse.values, &sparse.indices].into_iter().flatten() {
                self.tensor(tensor)?;
            }
        }
        for node in &graph.node {
            self.node(node)?;
        }
        Ok(())
    }

    fn node(&mut self, node: &NodeProto) -> Result<(), ReadError> {
        let op = node.op_type.as_deref().unwrap_or_default();
        let domain = node.domain.as_deref().unwrap_or_default();
        let full_name = match domain {
            "" | "ai.onnx" => op.to_owned(),
            domain => format!("{domain}.{op}"),
        };
        *self.operators.entry(full_name).or_default() += 1;

        let place = format!("{op} node \"{}\"", node.name.as_deref().unwrap_or_default());
        let windowed = op.contains("Conv") || op.contains("Pool");
        for attribute in &node.attribute {
            let name = attribute.name.as_deref().unwrap_or_default();
            let divisors: &[i64] = match name {
                // An attribute that is there without a value counts as zero in every runtime.
                "group" => &[attribute.i.unwrap_or(0)],
                "strides" | "dilations" | "kernel_shape" => &attribute.ints,
                _ => &[],
            };
            let by_reference = attribute
                .ref_attr_name
                .as_deref()
                .is_some_and(|n| !n.is_empty());
            if windowed
                && (divisors.iter().any(|&value| value < 1) || by_reference && name == "group")
            {
                return Err(self.refuse(format!(
                    "the {place} has a \"{name}\" below 1, which crashes runtimes"
                )));
            }
            self.attribute(attribute, &place)?;
        }
        Ok(())
    }

    fn attribute(&mut self, attribute: &AttributeProto, place: &str) -> Result<(), ReadError> {
        let sparse = attribute
            .sparse_tensor
            .iter()
            .chain(&attribute.sparse_tensors);
        let parts = sparse
            .flat_map(|sparse| [&sparse.values, &sparse.indices])
            .flatten();
        for tensor in attribute.t.iter().chain(&attribute.tensors).chain(parts) {
            self.tensor_in(tensor, place)?;
        }
        for graph in attribute.g.iter().chain(&attribute.graphs) {
            self.graph(graph)?;
        }
        Ok(())
    }

    fn tensor(&mut self, tensor: &TensorProto) -> Result<(), ReadError> {
        self.tensor_in(tensor, "the graph")
    }

    fn tensor_in(&mut self, tensor: &TensorProto, place: &str) -> Result<(), ReadError> {
        let name = tensor.name.as_deref().unwrap_or_default();
        let constant = || format!("the constant \"{name}\" of {place}");
        let Some(count) = elements(&tensor.dims) else {
            let problem = format!("{} has the impossible shape {:?}", constant(), tensor.dims);
            return Err(self.refuse(problem));
        };
        let kind = ElementType(tensor.data_type.unwrap_or(0));
        let wanted = match kind.bits().map(|bits| count.checked_mul(bits)) {
            Some(Some(bits)) => Some(bits.div_ceil(8)),
            Some(None) => {
                let problem = format!("{} has the impossible shape {:?}", constant(), tensor.dims);
                return Err(self.refuse(problem));
            }
            None => None,
        };
        if tensor.data_location == Some(DATA_LOCATION_EXTERNAL) {
            return self.external(tensor, wanted, &constant());
        }
        let stored = match (&tensor.raw_data, kind.0) {
            (Some(raw), _) if !raw.is_empty() => wanted.map(|wanted| (wanted, raw.len() as u64)),
            (_, data_type::FLOAT) => Some((count, tensor.float_data.len() as u64)),
            (_, data_type::INT64) => Some((count, tensor.int64_data.len() as u64)),
            (_, data_type::DOUBLE) => Some((count, tensor.double_data.len() as u64)),
            (_, data_type::INT32 | data_type::INT8 | data_type::UINT8 | data_type::BOOL) => {
                Some((count, tensor.int32_data.len() as u64))
            }
            _ => None,
        };
        match stored {
            Some((wanted, found)) if wanted != found => Err(self.refuse(format!(
                "{} has shape {:?} but {found} of {wanted} units of data",
                constant(),
                tensor.dims
            ))),
            _ => Ok(()),
        }
    }

    fn external(
        &mut self,
        tensor: &TensorProto,
        wanted: Option<u64>,
        constant: &str,
    ) -> Result<(), ReadError> {
        let fail = |problem: String| {
            Err(ReadError::ExternalData {
                path: self.path.to_owned(),
                problem,
            })
        };
        let get = |key: &str| {
            let entry = tensor
                .external_data
                .iter()
                .find(|e| e.key.as_deref() == Some(key));
            entry.and_then(|entry| entry.value.as_deref())
        };
        let number = |key: &str| get(key).map(str::parse::<u64>).transpose();
        let Some(folder) = self.folder else {
            return fail(format!(
                "{constant} is stored outside, which needs a model file on disk"
            ));
        };
        let Some(location) = get("location").filter(|location| !location.is_empty()) else {
            return fail(format!("{constant} names no file"));
        };
        // A backslash or a drive letter is a plain character here and a way out elsewhere.
        let plain = Path::new(location)
            .components()
            .all(|c| matches!(c, Component::Normal(_)));
        if !plain || location.contains(['\\', ':', '\0']) {
            return fail(format!(
                "{constant} is stored in \"{location}\", which is not a file inside the model's folder"
            ));
        }
        let file = folder.join(location);
        let inside = match (file.canonicalize(), folder.canonicalize()) {
            (Ok(file), Ok(folder)) => file.starts_with(folder),
            (Err(error), _) | (_, Err(error)) => {
                return fail(format!(
                    "{constant} is stored in \"{}\", which cannot be opened ({error}); copy it beside the model",
                    file.display()
                ));
            }
        };
        if !inside {
            return fail(format!(
                "{constant} is stored in \"{location}\", a link that leaves the model's folder"
            ));
        }
        let size = match std::fs::metadata(&file) {
            Ok(status) if status.is_file() => status.len(),
            Ok(_) => {
                return fail(format!(
                    "{constant} is stored in \"{location}\", which is no file"
                ));
            }
            Err(error) => return fail(format!("{}: {error}", file.display())),
        };
        let (Ok(offset), Ok(length)) = (number("offset"), number("length")) else {
            return fail(format!(
                "{constant} has an offset or length that is no number"
            ));
        };
        let offset = offset.unwrap_or(0);
        let length = length.or(wanted).unwrap_or(0);
        if wanted.is_some_and(|wanted| wanted != length) {
            return fail(format!(
                "{constant} has shape {:?} but {length} bytes of data",
                tensor.dims
            ));
        }
        if offset.checked_add(length).is_none_or(|end| end > size) {
            return fail(format!(
                "{constant} lies at bytes {offset} to {} of \"{location}\", which has {size}; the file is truncated",
                offset.saturating_add(length)
            ));
        }
        self.external_files.insert(location.to_owned());
        Ok(())
    }
}
