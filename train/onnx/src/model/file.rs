//! Reading, checking and describing a model file.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use prost::Message;
use prost::bytes::Bytes;

use super::error::{ReadError, malformed};
use super::info::{ModelFile, ModelInfo, TensorInfo, tensor_info};
use super::walk::{Walk, elements};
use crate::metadata::ModelMetadata;
use crate::proto::ModelProto;

/// Protobuf's limit for one message.
const LARGEST_FILE: u64 = i32::MAX as u64;

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
