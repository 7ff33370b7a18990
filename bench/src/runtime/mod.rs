//! The two runtimes behind one enum: ONNX Runtime, opened at run time, and the embedded one,
//! which is pure Rust and always there.
//!
//! A model is loaded with a stated runtime on a stated device or not at all: asking for a GPU
//! never ends on the CPU in silence, and [`Session::provider`] names what the graph's nodes were
//! really given to. [`search`] finds the library of ONNX Runtime, [`install`] puts it there,
//! [`inventory`] says what this machine can run models on. What the tensors mean is not known
//! here; see [`crate::model`].

mod choice;
mod device;
mod error;
pub(crate) mod ffi;
pub mod install;
pub mod inventory;
mod onnxruntime;
mod output;
pub mod process;
pub mod search;
pub mod serve;

use std::{
    fmt,
    path::{Path, PathBuf},
};

use strat_onnx::embedded::EmbeddedSession;
use strat_store::guard::guarded;

use onnxruntime::{Loaded, RunError, provider_text, shorten};
use process::{Limits, Transport, Worker};

pub use choice::RuntimeChoice;
pub use device::{Device, ParseDeviceError};
pub use error::RuntimeError;
pub use ffi::CudaUnavailable;
pub use output::Output;

/// A runtime that is ready to load models.
#[derive(Clone, Copy)]
pub struct Runtime {
    kind: Kind,
    /// Models get processes of their own.
    limits: Option<Limits>,
}

#[derive(Clone, Copy)]
enum Kind {
    OnnxRuntime(&'static Loaded),
    Embedded,
}

impl fmt::Debug for Runtime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Runtime({self})")
    }
}

impl fmt::Display for Runtime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            Kind::OnnxRuntime(loaded) => write!(f, "onnxruntime {}", loaded.version),
            Kind::Embedded => write!(f, "embedded (rten)"),
        }
    }
}

impl Runtime {
    /// Finds the runtime that was asked for.
    ///
    /// The second value is a notice for the user when `auto` had to fall back to the embedded
    /// runtime. It never falls back when another device than the CPU is asked for.
    ///
    /// # Errors
    /// ONNX Runtime was demanded and is not there, or the device cannot work on this machine.
    pub fn resolve(
        choice: RuntimeChoice,
        device: Device,
    ) -> Result<(Self, Option<String>), RuntimeError> {
        if choice == RuntimeChoice::Embedded {
            return match device {
                Device::Cpu => Ok((Self::within(Kind::Embedded), None)),
                device => Err(RuntimeError::EmbeddedIsCpuOnly { device }),
            };
        }
        if let Some(index) = device.nvidia() {
            ffi::cuda_driver()?.has(index)?;
        }
        match onnxruntime::find(device.nvidia().is_some()) {
            Ok(loaded) => {
                if !onnxruntime::is_compiled_in(device) {
                    return Err(RuntimeError::NoProvider {
                        library: loaded.library.clone(),
                        device,
                    });
                }
                if matches!(device, Device::TensorRt(_)) && !ffi::opens(ffi::TENSORRT) {
                    return Err(RuntimeError::NoTensorRt {
                        device,
                        library: ffi::TENSORRT,
                    });
                }
                Ok((Self::within(Kind::OnnxRuntime(loaded)), None))
            }
            Err(reason) if choice == RuntimeChoice::Auto && device == Device::Cpu => Ok((
                Self::within(Kind::Embedded),
                Some(match reason {
                    RuntimeError::NotFound { .. } => {
                        "ONNX Runtime was not found; using the slower embedded runtime \
                         (remedy: `bench setup`)"
                            .to_owned()
                    }
                    other => format!("{other}; using the slower embedded runtime"),
                }),
            )),
            Err(reason) => Err(reason),
        }
    }

    fn within(kind: Kind) -> Self {
        Self { kind, limits: None }
    }

    /// The same, giving each model a process of its own that may take no more than `limits`; `None`
    /// loads models into this process. The program has to serve [`process::COMMAND`].
    #[must_use]
    pub fn isolated(self, limits: Option<Limits>) -> Self {
        Self { limits, ..self }
    }

    /// The library file, for run records; none for the embedded runtime.
    #[must_use]
    pub fn library(&self) -> Option<&Path> {
        match self.kind {
            Kind::OnnxRuntime(loaded) => Some(&loaded.library),
            Kind::Embedded => None,
        }
    }

    /// Loads a model file.
    ///
    /// `threads` is the number of threads within one operation (0: the runtime's choice).
    ///
    /// The caller has read the file with [`strat_onnx::model::read`] before: that refuses the
    /// files that would take a runtime down instead of giving an error.
    ///
    /// # Errors
    /// The runtime refuses the model, or the device cannot be used.
    pub fn load(
        &self,
        model: &Path,
        device: Device,
        threads: usize,
    ) -> Result<Session, RuntimeError> {
        let failed = |reason: String| RuntimeError::Load {
            runtime: self.to_string(),
            model: model.to_path_buf(),
            reason,
        };
        if let Some(limits) = self.limits {
            let choice = match self.kind {
                Kind::OnnxRuntime(_) => RuntimeChoice::Ort,
                Kind::Embedded => RuntimeChoice::Embedded,
            };
            let (worker, (runtime, provider, placement)) =
                Worker::start(choice, model, device, threads, limits)?;
            return Ok(Session {
                engine: Engine::Process(Box::new(worker)),
                runtime,
                provider,
                placement,
            });
        }
        match self.kind {
            Kind::Embedded if device != Device::Cpu => {
                Err(RuntimeError::EmbeddedIsCpuOnly { device })
            }
            Kind::Embedded => {
                let threads = (threads > 0).then_some(threads);
                // Its messages name the file themselves.
                let session = EmbeddedSession::load(model, threads)?;
                Ok(Session {
                    engine: Engine::Embedded(Box::new(session)),
                    runtime: self.to_string(),
                    provider: "rten CPU".to_owned(),
                    placement: Vec::new(),
                })
            }
            Kind::OnnxRuntime(loaded) => {
                let session = guarded("its binding", || {
                    onnxruntime::load(loaded, model, device, threads)
                });
                let session = session.map_err(failed)?.map_err(|error| {
                    let mut reason = shorten(error.message());
                    if device.nvidia().is_some() && reason.contains("Failed to load library") {
                        reason += "; `bench setup --gpu` installs the CUDA libraries it needs";
                    }
                    failed(reason)
                })?;
                let placement = ffi::providers_of(&session);
                let provider = provider_text(&placement, device);
                if !provider.contains(device.provider()) {
                    return Err(failed(format!(
                        "no node of the graph runs on {}, all are given to {provider}",
                        device.provider()
                    )));
                }
                Ok(Session {
                    engine: Engine::OnnxRuntime(session),
                    runtime: self.to_string(),
                    provider,
                    placement,
                })
            }
        }
    }

    /// Proves that a device works: a convolution is loaded onto it and run.
    ///
    /// Returns the provider that ran it.
    ///
    /// # Errors
    /// As [`load`](Self::load) and [`Session::run`], or the scratch file cannot be written.
    pub fn try_device(&self, device: Device) -> Result<String, RuntimeError> {
        let failed = |reason: String| RuntimeError::Load {
            runtime: self.to_string(),
            model: PathBuf::from("a test graph"),
            reason,
        };
        let bytes = test_graph().map_err(|error| failed(error.to_string()))?;
        let file = tempfile::NamedTempFile::new()
            .and_then(|mut file| {
                std::io::Write::write_all(&mut file, &bytes)?;
                Ok(file)
            })
            .map_err(|error| failed(error.to_string()))?;
        let mut session = self
            .load(file.path(), device, 1)
            .map_err(|error| match error {
                // The name of a scratch file means nothing to a reader.
                RuntimeError::Load { reason, .. } => failed(reason),
                other => other,
            })?;
        session.run("x", [1, 3, 8, 8], &[0.5; 192], "y")?;
        Ok(session.provider)
    }
}

/// The smallest graph that an accelerator would care to take.
fn test_graph() -> Result<Vec<u8>, strat_onnx::graph::GraphError> {
    use strat_onnx::graph::{Filter, Geometry, GraphBuilder};
    let mut graph = GraphBuilder::new("device test");
    let input = graph.input("x", &[1.into(), 3.into(), 8.into(), 8.into()])?;
    let filter = Filter {
        shape: [4, 3, 3, 3],
        weights: vec![0.1; 108],
        bias: vec![0.0; 4],
    };
    let value = graph.conv("conv", input, filter, Geometry::new(1, 1))?;
    let value = graph.relu("relu", value)?;
    graph.output("y", value)?;
    graph.finish(None)
}

/// A model loaded into a runtime.
pub struct Session {
    engine: Engine,
    runtime: String,
    provider: String,
    placement: Vec<(String, usize)>,
}

enum Engine {
    OnnxRuntime(ort::session::Session),
    Embedded(Box<EmbeddedSession>),
    Process(Box<Worker>),
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Session")
            .field("runtime", &self.runtime)
            .field("provider", &self.provider)
            .finish_non_exhaustive()
    }
}

impl Session {
    /// The runtime and its version.
    #[must_use]
    pub fn runtime(&self) -> &str {
        &self.runtime
    }

    /// The execution provider that the graph's nodes were really given to.
    #[must_use]
    pub fn provider(&self) -> &str {
        &self.provider
    }

    /// How many nodes of the optimised graph each provider holds, sorted by provider; empty where
    /// the runtime does not tell.
    #[must_use]
    pub fn placement(&self) -> &[(String, usize)] {
        &self.placement
    }

    /// The process of the model has ended, so that nothing more can be asked of it.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        matches!(&self.engine, Engine::Process(worker) if worker.has_ended())
    }

    /// Time that goes into handing tensors to the process of the model and back.
    #[must_use]
    pub fn transport(&self) -> Transport {
        match &self.engine {
            Engine::Process(worker) => worker.transport.clone(),
            _ => Transport::default(),
        }
    }

    /// Runs the model on one input tensor `[n, c, h, w]`, whose values are converted to the type that the
    /// input takes: 32- or 16-bit floats, or whole numbers of 8 bits. All outputs are named; only the
    /// `wanted` one need have its values.
    ///
    /// # Errors
    /// The runtime fails, or an output is a tensor of another type than those.
    pub fn run(
        &mut self,
        input: &str,
        shape: [usize; 4],
        data: &[f32],
        wanted: &str,
    ) -> Result<Vec<Output>, RuntimeError> {
        let outputs = match &mut self.engine {
            Engine::Process(worker) => return worker.run(input, shape, data, wanted),
            Engine::Embedded(session) => {
                let outputs = session.run(input, &shape, data);
                outputs.map_err(RuntimeError::from)
            }
            Engine::OnnxRuntime(session) => {
                let runtime = &self.runtime;
                let failed = |reason: String| RuntimeError::Run {
                    runtime: runtime.clone(),
                    reason,
                };
                let outputs = onnxruntime::run(session, input, shape, data, wanted);
                outputs.map_err(|error| match error {
                    RunError::Failed(error) => failed(shorten(error.message())),
                    RunError::Panicked(reason) => failed(reason),
                    RunError::Type { name, found } => RuntimeError::NotFloat { name, found },
                })
            }
        };
        let outputs = outputs?.into_iter();
        Ok(outputs
            .map(|(name, shape, data)| Output { name, shape, data })
            .collect())
    }
}

/// Which provider holds how many nodes of a graph, where the runtime tells.
#[must_use]
pub fn placement_text(placement: &[(String, usize)]) -> Option<String> {
    let parts: Vec<String> = placement
        .iter()
        .map(|(provider, nodes)| format!("{nodes} nodes on {provider}"))
        .collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn embedded_knows_the_processor_only() {
        for device in &Device::KINDS[1..] {
            let error = Runtime::resolve(RuntimeChoice::Embedded, *device).unwrap_err();
            assert!(error.to_string().contains("CPU only"), "{error}");
        }
    }

    #[test]
    fn devices_are_words_with_a_number() {
        for device in Device::KINDS {
            assert_eq!(device.to_string().parse(), Ok(device));
        }
        assert_eq!("cuda".parse(), Ok(Device::Cuda(0)));
        assert_eq!("cuda:3".parse(), Ok(Device::Cuda(3)));
        for wrong in [
            "", "gpu", "cuda:", "cuda:-1", "cuda:300", "cpu:0", "coreml:1", "CUDA",
        ] {
            let error = wrong.parse::<Device>().unwrap_err();
            assert!(error.to_string().contains("cuda:1"), "{error}");
        }
    }

    #[test]
    fn the_provider_is_what_the_library_reports() {
        if let install::Availability::Unavailable(reason) = install::ensure_runtime() {
            strat_needs::Need::OnnxRuntime.is_lacking(reason);
            return;
        }
        let mut graph = strat_onnx::graph::GraphBuilder::new("one node");
        let input = graph.input("x", &[1.into()]).unwrap();
        let output = graph.relu("relu", input).unwrap();
        graph.output("y", output).unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), graph.finish(None).unwrap()).unwrap();
        let loaded = onnxruntime::find(false).unwrap();
        let session = onnxruntime::load(loaded, file.path(), Device::Cpu, 1).unwrap();
        assert_eq!(
            ffi::providers_of(&session),
            [("CPUExecutionProvider".to_owned(), 1)]
        );
    }

    /// Past the checks that come before: the library itself must refuse, not run on the CPU.
    #[test]
    fn a_provider_that_cannot_start_is_an_error() {
        if let install::Availability::Unavailable(reason) = install::ensure_runtime() {
            strat_needs::Need::OnnxRuntime.is_lacking(reason);
            return;
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), test_graph().unwrap()).unwrap();
        let loaded = onnxruntime::find(false).unwrap();
        let mut refused = 0;
        for device in &Device::KINDS[1..] {
            if onnxruntime::is_compiled_in(*device) {
                eprintln!("skipped: this library has {}", device.provider());
                continue;
            }
            let Err(error) = onnxruntime::load(loaded, file.path(), *device, 1) else {
                panic!("{device} was replaced in silence");
            };
            eprintln!("{device}: {}", shorten(error.message()));
            refused += 1;
        }
        // No library has both CUDA, Core ML and DirectML.
        assert!(refused >= 2, "{refused}");
    }

    #[test]
    fn several_providers_are_all_named() {
        let text = provider_text(
            &[
                ("CPUExecutionProvider".to_owned(), 2),
                ("CUDAExecutionProvider".to_owned(), 90),
            ],
            Device::Cuda(0),
        );
        assert_eq!(
            text,
            "CPUExecutionProvider (2 nodes) + CUDAExecutionProvider (90 nodes)"
        );
        assert_eq!(provider_text(&[], Device::Cpu), "CPUExecutionProvider");
        let unknown = provider_text(&[], Device::TensorRt(1));
        assert_eq!(
            unknown,
            "TensorrtExecutionProvider (share of nodes unknown)"
        );
    }
}
