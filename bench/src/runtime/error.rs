//! Why a runtime or a model cannot be used.

use std::path::PathBuf;

use strat_onnx::embedded::EmbeddedError;

use super::{device::Device, ffi::CudaUnavailable};

/// Why a runtime or a model could not be used.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// No usable ONNX Runtime library.
    #[error(
        "ONNX Runtime was not found ({looked_at}); install it with `bench setup`, \
         or use `--runtime embedded`"
    )]
    NotFound {
        /// Each place and why it did not serve.
        looked_at: String,
    },
    /// The library was found, but would not start.
    #[error("the ONNX Runtime in {} did not start: {reason}", library.display())]
    NotStarted {
        /// The library.
        library: PathBuf,
        /// Its own words, shortened.
        reason: String,
    },
    /// An NVIDIA device was asked for and cannot work here.
    #[error(transparent)]
    Cuda(#[from] CudaUnavailable),
    /// The embedded runtime knows no device but the processor.
    #[error(
        "the embedded runtime runs on the CPU only; `--device {device}` needs ONNX Runtime \
         (`bench setup{}`)",
        if device.nvidia().is_some() { " --gpu" } else { "" }
    )]
    EmbeddedIsCpuOnly {
        /// The device asked for.
        device: Device,
    },
    /// The library in use was built without the provider.
    #[error(
        "the ONNX Runtime in {} was built without {}, which `--device {device}` needs; {}",
        library.display(), device.provider(), device.remedy()
    )]
    NoProvider {
        /// The library.
        library: PathBuf,
        /// The device asked for.
        device: Device,
    },
    /// TensorRT's own library is missing.
    #[error(
        "`--device {device}` needs TensorRT 10, but its {library} could not be opened; install it \
         (pip package tensorrt-cu13) and put its folder into LD_LIBRARY_PATH, or use \
         `--device cuda`"
    )]
    NoTensorRt {
        /// The device asked for.
        device: Device,
        /// File name of TensorRT's library.
        library: &'static str,
    },
    /// The runtime refused the model.
    #[error("{runtime} cannot load {}: {reason}", model.display())]
    Load {
        /// Which runtime.
        runtime: String,
        /// The model file.
        model: PathBuf,
        /// The runtime's words, shortened.
        reason: String,
    },
    /// The model failed while running.
    #[error("{runtime} failed while running the model: {reason}")]
    Run {
        /// Which runtime.
        runtime: String,
        /// The runtime's words, shortened.
        reason: String,
    },
    /// The embedded runtime refused the model or failed to run it.
    #[error(transparent)]
    Embedded(#[from] EmbeddedError),
    /// What a runtime in another process has said, as a whole sentence.
    #[error("{reason}")]
    Told {
        /// The sentence.
        reason: String,
    },
    /// The process that ran the model is over; nothing more can be asked of it.
    #[error("{reason}")]
    Ended {
        /// Why, as a sentence.
        reason: String,
    },
    /// There is no process for the model.
    #[error(
        "a process for the model cannot be started ({reason}); --in-process runs it within this one, \
         without limits on memory and time"
    )]
    NoProcess {
        /// What the system said.
        reason: String,
    },
    /// An output is a tensor of a type that maps do not have.
    #[error("the model's output `{name}` is {found}; maps are read as f32, f16 or u8")]
    NotFloat {
        /// The output.
        name: String,
        /// What it is, in the runtime's words.
        found: String,
    },
}
