//! Weights in other files: only inside the model's folder, and whole.

use std::path::{Component, Path};

use crate::proto::TensorProto;

/// Most bytes of such a file: the embedded runtime holds it in memory.
const LARGEST_FILE: u64 = 16_000_000_000;

/// The file, relative to the model's `folder`, that holds a tensor of `wanted` bytes. `constant` names it
/// in sentences.
///
/// # Errors
/// With what is wrong, as part of a sentence.
pub(super) fn location(
    tensor: &TensorProto,
    wanted: Option<u64>,
    constant: &str,
    folder: Option<&Path>,
) -> Result<String, String> {
    let get = |key: &str| {
        let entry = tensor
            .external_data
            .iter()
            .find(|e| e.key.as_deref() == Some(key));
        entry.and_then(|entry| entry.value.as_deref())
    };
    let number = |key: &str| get(key).map(str::parse::<u64>).transpose();
    let Some(folder) = folder else {
        return Err(format!(
            "{constant} is stored outside, which needs a model file on disk"
        ));
    };
    let Some(location) = get("location").filter(|location| !location.is_empty()) else {
        return Err(format!("{constant} names no file"));
    };
    // A backslash or a drive letter is a plain character here and a way out elsewhere.
    let plain = Path::new(location)
        .components()
        .all(|c| matches!(c, Component::Normal(_)));
    if !plain || location.contains(['\\', ':', '\0']) {
        return Err(format!(
            "{constant} is stored in \"{location}\", which is not a file inside the model's folder"
        ));
    }
    let file = folder.join(location);
    let inside = match (file.canonicalize(), folder.canonicalize()) {
        (Ok(file), Ok(folder)) => file.starts_with(folder),
        (Err(error), _) | (_, Err(error)) => {
            return Err(format!(
                "{constant} is stored in \"{}\", which cannot be opened ({error}); copy it beside the model",
                file.display()
            ));
        }
    };
    if !inside {
        return Err(format!(
            "{constant} is stored in \"{location}\", a link that leaves the model's folder"
        ));
    }
    let size = match std::fs::metadata(&file) {
        Ok(status) if status.is_file() => status.len(),
        Ok(_) => {
            return Err(format!(
                "{constant} is stored in \"{location}\", which is not a file"
            ));
        }
        Err(error) => return Err(format!("{}: {error}", file.display())),
    };
    if size > LARGEST_FILE {
        return Err(format!(
            "{constant} is stored in \"{location}\", which has {size} bytes; at most {LARGEST_FILE} are read"
        ));
    }
    let (Ok(offset), Ok(length)) = (number("offset"), number("length")) else {
        return Err(format!(
            "{constant} has an offset or length that is not a number"
        ));
    };
    let offset = offset.unwrap_or(0);
    let length = length.or(wanted).unwrap_or(0);
    if wanted.is_some_and(|wanted| wanted != length) {
        return Err(format!(
            "{constant} has shape {:?} but {length} bytes of data",
            tensor.dims
        ));
    }
    if offset.checked_add(length).is_none_or(|end| end > size) {
        return Err(format!(
            "{constant} lies at bytes {offset} to {} of \"{location}\", which has {size}; the file is truncated",
            offset.saturating_add(length)
        ));
    }
    Ok(location.to_owned())
}
