//! Initial weights: networks that begin with the numbers of a file instead of those of the seed.
//!
//! The file is a safetensors file. Its tensors have the names and the layout of the exported
//! ONNX model's initialisers (`encoder.conv1.weight` is `[out, in, k, k]`, a transposed convolution
//! `[in, out, k, k]`), those of a discriminator begin with `discriminator.` (`discriminator-right.`
//! where each view has its own). What the file lacks starts as the seed says; what it holds must
//! fit by name and shape, so that a misspelt name is no silent start from noise.
//!
//! A file written by [`write()`] names the drives its weights were trained on, so that a model that
//! grew from them can still be checked for leakage.
//!
//! Not here: optimizer states (a run is continued with `--resume`), other file formats.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use half::{bf16, f16};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use strat_store::files;
use strat_store::inputs::{self, Kind};

use crate::error::{Error, Result};

/// Key of the file's metadata under which the drives stand, separated by spaces.
const DRIVES: &str = "train_drives";

/// What every tensor of a discriminator begins with.
const DISCRIMINATOR: &str = "discriminator";

/// A named block of weights, as files hold it.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// For example `encoder.conv1.weight`.
    pub name: String,
    /// Sizes, outermost first.
    pub shape: Vec<usize>,
    /// Row-major.
    pub values: Vec<f32>,
}

/// The tensors of a initial-weights file.
#[derive(Clone, Debug)]
pub struct InitialWeights {
    path: PathBuf,
    tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    digest: String,
    drives: Option<Vec<String>>,
}

impl InitialWeights {
    /// Reads a safetensors file with numbers of 16 or 32 bits.
    ///
    /// # Errors
    /// When there is no such file, it is damaged, or it holds other types or values that are not
    /// finite.
    pub fn read(path: &Path) -> Result<Self> {
        let refuse = |reason: String| Error::InitialWeights {
            path: path.to_path_buf(),
            reason,
        };
        let bytes = inputs::read(path, Kind::Weights).map_err(|error| refuse(error.to_string()))?;
        Self::parse(&bytes, path)
    }

    /// As [`read`](Self::read), from memory; `path` stands in messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self> {
        let refuse = |reason: String| Error::InitialWeights {
            path: path.to_path_buf(),
            reason,
        };
        let damaged = |error| refuse(format!("it is not a whole safetensors file ({error})"));
        let file = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            let values = numbers(&view).ok_or_else(|| {
                refuse(format!(
                    "the tensor `{name}` holds {:?}; weights are F32, F16 or BF16",
                    view.dtype()
                ))
            })?;
            if values.iter().any(|value| !value.is_finite()) {
                return Err(refuse(format!(
                    "the tensor `{name}` holds values that are not finite"
                )));
            }
            tensors.insert(name.to_owned(), (view.shape().to_vec(), values));
        }
        let drives = header
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(DRIVES))
            .map(|text| text.split_whitespace().map(str::to_owned).collect());
        Ok(Self {
            path: path.to_path_buf(),
            tensors,
            digest: files::blake3_hex(bytes),
            drives,
        })
    }

    /// BLAKE3 of the file.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// The drives that the weights were trained on; `None` when the file does not say.
    #[must_use]
    pub fn drives(&self) -> Option<&[String]> {
        self.drives.as_deref()
    }

    /// The values of `name` if the file has it in this shape.
    #[must_use]
    pub fn values(&self, name: &str, shape: &[usize]) -> Option<Vec<f32>> {
        let (own, values) = self.tensors.get(name)?;
        (own == shape).then(|| values.clone())
    }

    /// Compares the file with the parameters of the networks it is for; a sentence with what comes
    /// from the file.
    ///
    /// # Errors
    /// When a tensor has another shape than the parameter of its name, belongs to no parameter of
    /// the generator, or none fits. Tensors of a discriminator may be left over.
    pub fn check(&self, parameters: &[Parameter]) -> Result<String> {
        let refuse = |reason: String| {
            Err(Error::InitialWeights {
                path: self.path.clone(),
                reason,
            })
        };
        let known: BTreeMap<&str, &[usize]> = parameters
            .iter()
            .map(|parameter| (parameter.name.as_str(), parameter.shape.as_slice()))
            .collect();
        let mut used = 0;
        let mut unknown = Vec::new();
        for (name, (shape, _)) in &self.tensors {
            match known.get(name.as_str()) {
                Some(wanted) if wanted == shape => used += 1,
                Some(wanted) => {
                    return refuse(format!(
                        "its tensor `{name}` is {shape:?}, but the network's is {wanted:?}; train \
                         with the network settings that the weights were made with"
                    ));
                }
                None if name.starts_with(DISCRIMINATOR) => {}
                None => unknown.push(format!("`{name}`")),
            }
        }
        if !unknown.is_empty() {
            let more = unknown.len().saturating_sub(3);
            unknown.truncate(3);
            let tail = if more > 0 {
                format!(" and {more} more")
            } else {
                String::new()
            };
            return refuse(format!(
                "the network has no {}{tail}; tensors are named as in an exported model, for \
                 example `encoder.conv1.weight`",
                unknown.join(", ")
            ));
        }
        if used == 0 {
            return refuse("none of its tensors belongs to the networks".to_owned());
        }
        let left = self.tensors.len() - used;
        let left = if left > 0 {
            format!("; {left} tensors of a discriminator are not used")
        } else {
            String::new()
        };
        Ok(format!(
            "initial weights from {}: {used} of {} tensors of the networks{left}",
            self.path.display(),
            parameters.len()
        ))
    }
}

/// The numbers of a tensor, or nothing for a type that weights do not have.
fn numbers(view: &TensorView) -> Option<Vec<f32>> {
    let bytes = view.data();
    match view.dtype() {
        Dtype::F32 => {
            let (numbers, _) = bytes.as_chunks::<4>();
            Some(numbers.iter().map(|b| f32::from_le_bytes(*b)).collect())
        }
        Dtype::F16 => Some(halves(bytes, |b| f16::from_le_bytes(b).to_f32())),
        Dtype::BF16 => Some(halves(bytes, |b| bf16::from_le_bytes(b).to_f32())),
        _ => None,
    }
}

fn halves(bytes: &[u8], read: impl Fn([u8; 2]) -> f32) -> Vec<f32> {
    let (numbers, _) = bytes.as_chunks::<2>();
    numbers.iter().map(|b| read(*b)).collect()
}

/// Writes parameters as a safetensors file of 32-bit numbers that names the drives they were
/// trained on, where those are known.
///
/// # Errors
/// When the file cannot be written.
pub fn write(parameters: &[Parameter], drives: Option<&[String]>, path: &Path) -> Result<()> {
    let encoded: Vec<Vec<u8>> = parameters
        .iter()
        .map(|parameter| {
            let numbers = parameter.values.iter();
            numbers.flat_map(|value| value.to_le_bytes()).collect()
        })
        .collect();
    let wrong = |error: safetensors::SafeTensorError| Error::Export(error.to_string());
    let views = parameters
        .iter()
        .zip(&encoded)
        .map(|(parameter, bytes)| {
            let view = TensorView::new(Dtype::F32, parameter.shape.clone(), bytes);
            Ok((parameter.name.as_str(), view.map_err(wrong)?))
        })
        .collect::<Result<Vec<_>>>()?;
    // One key only: the crate writes several in the order of a hash map.
    let metadata = drives.map(|drives| HashMap::from([(DRIVES.to_owned(), drives.join(" "))]));
    let bytes = safetensors::serialize(views, metadata).map_err(wrong)?;
    Ok(files::write_atomic(path, &bytes)?)
}

/// The drives of a file that [`write()`] has written; none of another file, or where it does not name
/// them.
pub fn drives_of_own(path: &Path) -> Option<Vec<String>> {
    let bytes = fs_err::read(path).ok()?;
    let (_, header) = SafeTensors::read_metadata(&bytes).ok()?;
    let drives = header.metadata().as_ref()?.get(DRIVES)?;
    Some(drives.split_whitespace().map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameter(name: &str, shape: &[usize], values: &[f32]) -> Parameter {
        Parameter {
            name: name.to_owned(),
            shape: shape.to_vec(),
            values: values.to_vec(),
        }
    }

    fn written(parameters: &[Parameter]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("start.safetensors");
        let drives = ["a".to_owned(), "b".to_owned()];
        write(parameters, Some(&drives), &path).unwrap();
        (folder, path)
    }

    #[test]
    fn what_was_written_is_read_with_its_drives() {
        let own = [
            parameter("x.weight", &[1, 2], &[0.5, -1.0]),
            parameter("discriminator.last.bias", &[1], &[3.0]),
        ];
        let (_folder, path) = written(&own);
        let start = InitialWeights::read(&path).unwrap();
        assert_eq!(start.drives().unwrap(), ["a", "b"]);
        assert_eq!(start.values("x.weight", &[1, 2]), Some(vec![0.5, -1.0]));
        assert_eq!(start.values("x.weight", &[2, 1]), None);
        assert_eq!(start.values("y.weight", &[1, 2]), None);
        assert!(start.check(&own).unwrap().contains("2 of 2"));
        // A run without a discriminator has no use for its weights, which is said.
        let text = start.check(&own[..1]).unwrap();
        assert!(
            text.contains("1 of 1") && text.contains("not used"),
            "{text}"
        );
    }

    #[test]
    fn half_precision_is_widened_and_other_types_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("half.safetensors");
        let put = |dtype, bytes: &[u8]| {
            let view = TensorView::new(dtype, vec![2], bytes).unwrap();
            std::fs::write(&path, safetensors::serialize([("x", view)], None).unwrap()).unwrap();
            InitialWeights::read(&path)
        };
        let f = [f16::from_f32(0.5), f16::from_f32(-2.0)].map(f16::to_le_bytes);
        let start = put(Dtype::F16, f.as_flattened()).unwrap();
        assert_eq!(start.values("x", &[2]), Some(vec![0.5, -2.0]));
        assert_eq!(start.drives(), None);
        let b = [bf16::from_f32(0.25), bf16::from_f32(8.0)].map(bf16::to_le_bytes);
        let start = put(Dtype::BF16, b.as_flattened()).unwrap();
        assert_eq!(start.values("x", &[2]), Some(vec![0.25, 8.0]));
        let text = put(Dtype::U8, &[1, 2]).unwrap_err().to_string();
        assert!(
            text.contains("U8") && text.contains("half.safetensors"),
            "{text}"
        );
        let nan = [f16::NAN, f16::ONE].map(f16::to_le_bytes);
        let text = put(Dtype::F16, nan.as_flattened()).unwrap_err().to_string();
        assert!(text.contains("not finite"), "{text}");
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let (_folder, path) = written(&[parameter("x.weight", &[2], &[1.0, 2.0])]);
        let start = InitialWeights::read(&path).unwrap();
        let refused = |parameters: &[Parameter]| start.check(parameters).unwrap_err().to_string();
        let text = refused(&[parameter("x.weight", &[3], &[0.0; 3])]);
        assert!(text.contains("[2]") && text.contains("[3]"), "{text}");
        let text = refused(&[parameter("y.weight", &[2], &[0.0; 2])]);
        assert!(text.contains("`x.weight`"), "{text}");
        let (_folder, path) = written(&[parameter("discriminator.x", &[1], &[1.0])]);
        let start = InitialWeights::read(&path).unwrap();
        let text = start.check(&[]).unwrap_err().to_string();
        assert!(text.contains("none"), "{text}");
    }

    #[test]
    fn damaged_and_absent_files_are_sentences() {
        let (folder, path) = written(&[parameter("x.weight", &[2], &[1.0, 2.0])]);
        let bytes = std::fs::read(&path).unwrap();
        for length in [0, 7, 30, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let text = InitialWeights::read(&path).unwrap_err().to_string();
            assert!(text.contains("not a whole safetensors file"), "{text}");
        }
        let text = InitialWeights::read(&folder.path().join("none"))
            .unwrap_err()
            .to_string();
        assert!(text.contains("none"), "{text}");
    }
}
