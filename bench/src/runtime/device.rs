//! Where models run (`--device`).

use std::fmt;

/// Where to run (`--device`): `cpu`, `cuda`, `cuda:1`, `tensorrt`, `coreml` or `directml`.
///
/// Numbers count devices from 0, in the order of the driver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// An NVIDIA device through ONNX Runtime's CUDA provider.
    Cuda(u8),
    /// An NVIDIA device through TensorRT; nodes that it does not take go to CUDA.
    TensorRt(u8),
    /// Apple's CoreML: the neural engine, the GPU or the processor, as the system decides.
    CoreMl,
    /// Any DirectX 12 device under Windows.
    DirectMl(u8),
}

impl Device {
    /// The first device of every kind.
    pub const KINDS: [Self; 5] = [
        Self::Cpu,
        Self::Cuda(0),
        Self::TensorRt(0),
        Self::CoreMl,
        Self::DirectMl(0),
    ];

    /// ONNX Runtime's name of the provider that serves this device.
    #[must_use]
    pub const fn provider(self) -> &'static str {
        match self {
            Self::Cpu => "CPUExecutionProvider",
            Self::Cuda(_) => "CUDAExecutionProvider",
            Self::TensorRt(_) => "TensorrtExecutionProvider",
            Self::CoreMl => "CoreMLExecutionProvider",
            Self::DirectMl(_) => "DmlExecutionProvider",
        }
    }

    /// The number that NVIDIA's driver counts this device by, where it is one of theirs.
    pub(super) const fn nvidia(self) -> Option<u8> {
        match self {
            Self::Cuda(index) | Self::TensorRt(index) => Some(index),
            Self::Cpu | Self::CoreMl | Self::DirectMl(_) => None,
        }
    }

    /// What to do when the library lacks the provider, as the end of a sentence.
    pub(super) const fn remedy(self) -> &'static str {
        match self {
            Self::Cpu => "every build has it, so this library is damaged",
            Self::Cuda(_) | Self::TensorRt(_) => "install the other build with `bench setup --gpu`",
            Self::CoreMl => {
                "the builds for macOS have it: run `bench setup` on a Mac, or leave out \
                 `--device coreml`"
            }
            Self::DirectMl(_) => {
                "the package onnxruntime-directml for Windows has it: point ORT_DYLIB_PATH at its \
                 library, or leave out `--device directml`"
            }
        }
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(index) => write!(f, "cuda:{index}"),
            Self::TensorRt(index) => write!(f, "tensorrt:{index}"),
            Self::CoreMl => f.write_str("coreml"),
            Self::DirectMl(index) => write!(f, "directml:{index}"),
        }
    }
}

/// A text that names no device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown device \"{0}\"; known are cpu, cuda, tensorrt, coreml and directml, and a number \
     chooses among several: cuda:1"
)]
pub struct ParseDeviceError(String);

impl std::str::FromStr for Device {
    type Err = ParseDeviceError;

    fn from_str(text: &str) -> Result<Self, ParseDeviceError> {
        let unknown = || ParseDeviceError(text.to_owned());
        let (kind, index) = match text.split_once(':') {
            Some((kind, index)) => (kind, Some(index.parse().map_err(|_| unknown())?)),
            None => (text, None),
        };
        match (kind, index) {
            ("cpu", None) => Ok(Self::Cpu),
            ("cuda", index) => Ok(Self::Cuda(index.unwrap_or(0))),
            ("tensorrt", index) => Ok(Self::TensorRt(index.unwrap_or(0))),
            ("coreml", None) => Ok(Self::CoreMl),
            ("directml", index) => Ok(Self::DirectMl(index.unwrap_or(0))),
            _ => Err(unknown()),
        }
    }
}
