//! The two runtimes behind one enum: ONNX Runtime, opened at run time, and the embedded one,
//! which is pure Rust and always there.
//!
//! A model is loaded with a stated runtime on a stated device or not at all: asking for a GPU
//! never ends on the CPU in silence, and [`Session::provider`] names what the graph's nodes were
//! really given to. What the tensors mean is not known here; see [`crate::model`].

pub(crate) mod ffi;
pub mod inventory;
pub mod setup;

use std::{
    fmt,
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use strat_onnx::embedded::{EmbeddedError, EmbeddedSession};

use ffi::CudaUnavailable;
use setup::Surroundings;

/// Which runtime to use (`--runtime`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum RuntimeChoice {
    /// ONNX Runtime when its library is found, else the embedded runtime with a notice.
    #[default]
    Auto,
    /// ONNX Runtime or an error.
    #[value(alias = "onnxruntime")]
    Ort,
    /// The embedded runtime (CPU only, slower, needs nothing installed).
    Embedded,
}

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
    const fn nvidia(self) -> Option<u8> {
        match self {
            Self::Cuda(index) | Self::TensorRt(index) => Some(index),
            Self::Cpu | Self::CoreMl | Self::DirectMl(_) => None,
        }
    }

    /// What to do when the library lacks the provider, as the end of a sentence.
    const fn remedy(self) -> &'static str {
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
    "\"{0}\" is no device; known are cpu, cuda, tensorrt, coreml and directml, and a number \
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
    /// An output is not a tensor of 32-bit floats.
    #[error("the model's output `{name}` is not a tensor of 32-bit floats: {reason}")]
    NotFloat {
        /// The output.
        name: String,
        /// The runtime's words, shortened.
        reason: String,
    },
}

/// ONNX Runtime as loaded into this process.
struct Loaded {
    environment: ort::environment::Environment,
    library: PathBuf,
    version: String,
}

/// A runtime that is ready to load models.
#[derive(Clone, Copy)]
pub struct Runtime(Kind);

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
        match self.0 {
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
                Device::Cpu => Ok((Self(Kind::Embedded), None)),
                device => Err(RuntimeError::EmbeddedIsCpuOnly { device }),
            };
        }
        if let Some(index) = device.nvidia() {
            ffi::cuda_driver()?.has(index)?;
        }
        match onnxruntime(device.nvidia().is_some()) {
            Ok(loaded) => {
                if !is_compiled_in(device) {
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
                Ok((Self(Kind::OnnxRuntime(loaded)), None))
            }
            Err(reason) if choice == RuntimeChoice::Auto && device == Device::Cpu => Ok((
                Self(Kind::Embedded),
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

    /// The library file, for run records; none for the embedded runtime.
    #[must_use]
    pub fn library(&self) -> Option<&Path> {
        match self.0 {
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
        match self.0 {
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
                let session =
                    load_with_onnxruntime(loaded, model, device, threads).map_err(|error| {
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
        session.run("x", [1, 3, 8, 8], &[0.5; 192])?;
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
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Session")
            .field("runtime", &self.runtime)
            .field("provider", &self.provider)
            .finish_non_exhaustive()
    }
}

/// One output tensor, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// Its name in the graph.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Its values.
    pub data: Vec<f32>,
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

    /// Runs the model on one input tensor `[n, c, h, w]`.
    ///
    /// # Errors
    /// The runtime fails, or an output is not a tensor of 32-bit floats.
    pub fn run(
        &mut self,
        input: &str,
        shape: [usize; 4],
        data: &[f32],
    ) -> Result<Vec<Output>, RuntimeError> {
        match &mut self.engine {
            Engine::Embedded(session) => Ok(session
                .run(input, &shape, data)?
                .into_iter()
                .map(|(name, shape, data)| Output { name, shape, data })
                .collect()),
            Engine::OnnxRuntime(session) => {
                let runtime = &self.runtime;
                let failed = |error: ort::Error| RuntimeError::Run {
                    runtime: runtime.clone(),
                    reason: shorten(error.message()),
                };
                let tensor =
                    ort::value::TensorRef::from_array_view((shape, data)).map_err(failed)?;
                let outputs = session.run(ort::inputs![input => tensor]).map_err(failed)?;
                outputs
                    .iter()
                    .map(|(name, value)| {
                        let (shape, data) = value.try_extract_tensor::<f32>().map_err(|error| {
                            RuntimeError::NotFloat {
                                name: name.to_owned(),
                                reason: shorten(error.message()),
                            }
                        })?;
                        Ok(Output {
                            name: name.to_owned(),
                            // A tensor that exists has no negative dimension.
                            shape: shape
                                .iter()
                                .map(|&size| usize::try_from(size).unwrap_or(0))
                                .collect(),
                            data: data.to_vec(),
                        })
                    })
                    .collect()
            }
        }
    }
}

/// Loads ONNX Runtime into the process, once: a process can have one environment only.
fn onnxruntime(prefer_gpu: bool) -> Result<&'static Loaded, RuntimeError> {
    static LOADED: OnceLock<Loaded> = OnceLock::new();
    static ONE_AT_A_TIME: std::sync::Mutex<()> = std::sync::Mutex::new(());
    let _guard = ONE_AT_A_TIME
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    // A failed attempt leaves nothing behind, so only success is remembered.
    if let Some(loaded) = LOADED.get() {
        return Ok(loaded);
    }
    let mut looked_at = Vec::new();
    for candidate in Surroundings::of_this_process().candidates(prefer_gpu) {
        let library = candidate.path;
        let started = ffi::onnxruntime_version(&library).and_then(|version| {
            start(&library).map(|environment| Loaded {
                environment,
                library: library.clone(),
                version,
            })
        });
        match started {
            Ok(loaded) => return Ok(LOADED.get_or_init(|| loaded)),
            Err(reason) => {
                looked_at.push(format!("{}: {}", candidate.origin, shorten(&reason)));
            }
        }
    }
    Err(RuntimeError::NotFound {
        looked_at: looked_at.join("; "),
    })
}

fn start(library: &Path) -> Result<ort::environment::Environment, String> {
    let builder = ort::init_from(library).map_err(|error| error.to_string())?;
    let environment = builder
        .with_name("strat")
        .with_telemetry(false)
        // ONNX Runtime writes its errors to stderr as well as returning them; said once is enough.
        .with_logger(Arc::new(|level, _category, _id, _place, message| {
            if level >= ort::logging::LogLevel::Warning
                && std::env::var_os("STRAT_ORT_LOG").is_some()
            {
                eprintln!("onnxruntime: {message}");
            }
        }))
        .build()
        .map_err(|error| error.message().to_owned())?;
    environment.set_log_level(ort::logging::LogLevel::Warning);
    if let Some((toolkit, cudnn)) = setup::cuda_folders(library) {
        // Those that matter are opened; what is missing shows when the CUDA provider starts.
        let _ = ort::ep::cuda::preload_dylibs(Some(&toolkit), Some(&cudnn));
    }
    Ok(environment)
}

/// Whether the loaded library knows the provider; not whether the provider can start.
fn is_compiled_in(device: Device) -> bool {
    use ort::ep::ExecutionProvider as _;
    match device {
        Device::Cpu => Ok(true),
        Device::Cuda(_) => ort::ep::CUDA::is_available(),
        Device::TensorRt(_) => ort::ep::TensorRT::is_available(),
        Device::CoreMl => ort::ep::CoreML::is_available(),
        Device::DirectMl(_) => ort::ep::DirectML::is_available(),
    }
    .unwrap_or(false)
}

fn load_with_onnxruntime(
    loaded: &Loaded,
    model: &Path,
    device: Device,
    threads: usize,
) -> Result<ort::session::Session, ort::Error> {
    use ort::session::builder::AutoDevicePolicy;
    // The CPU provider is always last; its default here would switch the arena off.
    let cpu = ort::ep::CPU::default().with_arena_allocator(true).build();
    let cuda = |index: u8| {
        ort::ep::CUDA::default()
            .with_device_id(index.into())
            .build()
            .error_on_failure()
    };
    let providers = match device {
        Device::Cpu => vec![cpu],
        Device::Cuda(index) => vec![cuda(index), cpu],
        Device::TensorRt(index) => {
            let tensorrt = ort::ep::TensorRT::default()
                .with_device_id(index.into())
                .build()
                .error_on_failure();
            vec![tensorrt, cuda(index), cpu]
        }
        Device::CoreMl => vec![ort::ep::CoreML::default().build().error_on_failure(), cpu],
        Device::DirectMl(index) => {
            let directml = ort::ep::DirectML::default()
                .with_device_id(index.into())
                .build()
                .error_on_failure();
            vec![directml, cpu]
        }
    };
    ort::session::Session::builder(&loaded.environment)?
        // DirectML cannot work with planned memory; the others gain by it.
        .with_memory_pattern(!matches!(device, Device::DirectMl(_)))?
        // The binding's default prefers an NPU where there is one; a benchmark runs where it says.
        .with_auto_device(AutoDevicePolicy::PreferCPU)?
        .with_intra_threads(threads)?
        // Idle threads that spin take the cores from decoding and metrics on the rayon threads.
        .with_intra_op_spinning(false)?
        .with_inter_op_spinning(false)?
        .with_config_entry("session.record_ep_graph_assignment_info", "1")?
        .with_execution_providers(providers)?
        .commit_from_file(model)
}

/// Names the providers that hold nodes; the counts only where there is more than one.
fn provider_text(assigned: &[(String, usize)], device: Device) -> String {
    match assigned {
        [] => match device {
            Device::Cpu => device.provider().to_owned(),
            // Registered with an error on failure, so it is there; older libraries do not tell
            // which nodes it got.
            _ => format!("{} (share of nodes unknown)", device.provider()),
        },
        [(name, _)] => name.clone(),
        several => several
            .iter()
            .map(|(name, nodes)| format!("{name} ({nodes} nodes)"))
            .collect::<Vec<_>>()
            .join(" + "),
    }
}

/// Takes the status code off the front: `: 1 : FAIL : some text` becomes `some text`.
fn without_code(line: &str) -> &str {
    let stripped = line.strip_prefix(": ").and_then(|rest| {
        let (number, rest) = rest.split_once(" : ")?;
        let (word, text) = rest.split_once(" : ")?;
        let is_code = number.chars().all(|c| c.is_ascii_digit())
            && word.chars().all(|c| c.is_ascii_uppercase() || c == '_');
        is_code.then_some(text)
    });
    stripped.unwrap_or(line)
}

/// Takes the C++ source locations and symbol names out of ONNX Runtime's messages.
///
/// `…/core/session/x.cc:123 void onnxruntime::f(...) some text` becomes `some text`.
fn shorten(message: &str) -> String {
    let mut kept: Vec<&str> = Vec::new();
    for line in message.lines() {
        let mut line = line.trim();
        // A location is a path to a C++ file with a line number; the function follows it up to
        // its closing parenthesis, and the text comes after that.
        if let Some(end) = [".cc:", ".h:", ".cpp:", ".cu:"]
            .iter()
            .filter_map(|mark| line.find(mark).map(|at| at + mark.len()))
            .min()
        {
            let rest = line[end..].trim_start_matches(|c: char| c.is_ascii_digit());
            let after_function = rest
                .rfind("] ")
                .map(|at| at + 2)
                .or_else(|| rest.find(") ").map(|at| at + 2))
                .unwrap_or(0);
            line = rest[after_function..].trim();
        }
        line = without_code(line);
        if !line.is_empty() && !line.starts_with("Stacktrace") {
            kept.push(line);
        }
    }
    let text = kept.join(" ");
    const LONGEST: usize = 400;
    if text.chars().count() > LONGEST {
        let mut cut: String = text.chars().take(LONGEST).collect();
        cut.push('…');
        return cut;
    }
    if text.is_empty() {
        "no reason given".to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_lose_their_source_locations() {
        let long = "/onnxruntime_src/onnxruntime/core/graph/model.cc:180 onnxruntime::Model::Model(\
                    onnx::ModelProto&&, const onnxruntime::PathString&) Unsupported model IR version: 99";
        assert_eq!(shorten(long), "Unsupported model IR version: 99");
        assert_eq!(
            shorten("Load model from x.onnx failed:Protobuf parsing failed."),
            "Load model from x.onnx failed:Protobuf parsing failed."
        );
        // As ONNX Runtime 1.31.1 says it when a CUDA library is missing.
        let nested = "/onnxruntime_src/onnxruntime/core/session/provider_bridge_ort.cc:2397 \
                      onnxruntime::Provider& onnxruntime::ProviderLibrary::Get() \
                      [ONNXRuntimeError] : 1 : FAIL : Failed to load library x.so";
        assert_eq!(shorten(nested), "Failed to load library x.so");
        assert_eq!(without_code(": 1 : some : text"), ": 1 : some : text");
        assert_eq!(shorten(""), "no reason given");
        assert!(shorten(&"é".repeat(1000)).chars().count() <= 401);
    }

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
        if let setup::Availability::Unavailable(reason) = setup::ensure_runtime() {
            strat_needs::Need::OnnxRuntime.is_lacking(reason);
            return;
        }
        let mut graph = strat_onnx::graph::GraphBuilder::new("one node");
        let input = graph.input("x", &[1.into()]).unwrap();
        let output = graph.relu("relu", input).unwrap();
        graph.output("y", output).unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), graph.finish(None).unwrap()).unwrap();
        let loaded = onnxruntime(false).unwrap();
        let session = load_with_onnxruntime(loaded, file.path(), Device::Cpu, 1).unwrap();
        assert_eq!(
            ffi::providers_of(&session),
            [("CPUExecutionProvider".to_owned(), 1)]
        );
    }

    /// Past the checks that come before: the library itself must refuse, not run on the CPU.
    #[test]
    fn a_provider_that_cannot_start_is_an_error() {
        if let setup::Availability::Unavailable(reason) = setup::ensure_runtime() {
            strat_needs::Need::OnnxRuntime.is_lacking(reason);
            return;
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), test_graph().unwrap()).unwrap();
        let loaded = onnxruntime(false).unwrap();
        for device in &Device::KINDS[1..] {
            if is_compiled_in(*device) {
                eprintln!("skipped: this library has {}", device.provider());
                continue;
            }
            let Err(error) = load_with_onnxruntime(loaded, file.path(), *device, 1) else {
                panic!("{device} was replaced in silence");
            };
            eprintln!("{device}: {}", shorten(error.message()));
        }
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
