//! The two runtimes behind one enum: ONNX Runtime, opened at run time, and the embedded one,
//! which is pure Rust and always there.
//!
//! A model is loaded with a stated runtime on a stated device or not at all: asking for CUDA
//! never ends on the CPU in silence, and [`Session::provider`] names what the graph's nodes were
//! really given to. What the tensors mean is not known here; see [`crate::model`].

use std::{
    fmt,
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use strat_onnx::embedded::{EmbeddedError, EmbeddedSession};

use crate::{
    native::{self, CudaUnavailable},
    setup::{self, Surroundings},
};

/// Which runtime to use (`--runtime`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum RuntimeChoice {
    /// ONNX Runtime when its library is found, else the embedded runtime with a notice.
    #[default]
    Auto,
    /// ONNX Runtime or an error.
    Ort,
    /// The embedded runtime (CPU only, slower, needs nothing installed).
    Embedded,
}

/// Where to run (`--device`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// An NVIDIA device through ONNX Runtime's CUDA provider.
    Cuda,
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cpu => "cpu",
            Self::Cuda => "cuda",
        })
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
    /// CUDA was asked for and cannot work here.
    #[error(transparent)]
    Cuda(#[from] CudaUnavailable),
    /// The embedded runtime has no CUDA.
    #[error(
        "the embedded runtime runs on the CPU only; `--device cuda` needs ONNX Runtime \
         (`bench setup --gpu`)"
    )]
    EmbeddedHasNoCuda,
    /// The library in use was built without CUDA.
    #[error(
        "the ONNX Runtime in {} was built without CUDA; install the other build with \
         `bench setup --gpu`",
        library.display()
    )]
    NoCudaProvider {
        /// The library.
        library: PathBuf,
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
    /// runtime. It never falls back when CUDA is asked for.
    ///
    /// # Errors
    /// ONNX Runtime was demanded and is not there, or CUDA cannot work on this machine.
    pub fn resolve(
        choice: RuntimeChoice,
        device: Device,
    ) -> Result<(Self, Option<String>), RuntimeError> {
        if choice == RuntimeChoice::Embedded {
            return match device {
                Device::Cpu => Ok((Self(Kind::Embedded), None)),
                Device::Cuda => Err(RuntimeError::EmbeddedHasNoCuda),
            };
        }
        if device == Device::Cuda {
            native::cuda_driver()?;
        }
        match onnxruntime(device == Device::Cuda) {
            Ok(loaded) => {
                if device == Device::Cuda && !cuda_is_compiled_in() {
                    return Err(RuntimeError::NoCudaProvider {
                        library: loaded.library.clone(),
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
            Kind::Embedded if device == Device::Cuda => Err(RuntimeError::EmbeddedHasNoCuda),
            Kind::Embedded => {
                let threads = (threads > 0).then_some(threads);
                // Its messages name the file themselves.
                let session = EmbeddedSession::load(model, threads)?;
                Ok(Session {
                    engine: Engine::Embedded(Box::new(session)),
                    runtime: self.to_string(),
                    provider: "rten CPU".to_owned(),
                })
            }
            Kind::OnnxRuntime(loaded) => {
                let session = load_with_onnxruntime(loaded, model, device, threads)
                    .map_err(|error| failed(shorten(error.message())))?;
                let provider = provider_text(&native::providers_of(&session), device);
                if device == Device::Cuda && !provider.contains("CUDA") {
                    return Err(failed(format!(
                        "no node of the graph runs on CUDA, all are given to {provider}"
                    )));
                }
                Ok(Session {
                    engine: Engine::OnnxRuntime(session),
                    runtime: self.to_string(),
                    provider,
                })
            }
        }
    }
}

/// A model loaded into a runtime.
pub struct Session {
    engine: Engine,
    runtime: String,
    provider: String,
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
        let started = native::onnxruntime_version(&library).and_then(|version| {
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

fn cuda_is_compiled_in() -> bool {
    use ort::ep::ExecutionProvider as _;
    ort::ep::CUDA::is_available().unwrap_or(false)
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
    let providers = match device {
        Device::Cpu => vec![cpu],
        Device::Cuda => vec![ort::ep::CUDA::default().build().error_on_failure(), cpu],
    };
    ort::session::Session::builder(&loaded.environment)?
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
            Device::Cpu => "CPUExecutionProvider".to_owned(),
            // Registered with an error on failure, so it is there; older libraries do not tell
            // which nodes it got.
            Device::Cuda => "CUDAExecutionProvider (share of nodes unknown)".to_owned(),
        },
        [(name, _)] => name.clone(),
        several => several
            .iter()
            .map(|(name, nodes)| format!("{name} ({nodes} nodes)"))
            .collect::<Vec<_>>()
            .join(" + "),
    }
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
        assert_eq!(shorten(""), "no reason given");
        assert!(shorten(&"é".repeat(1000)).chars().count() <= 401);
    }

    #[test]
    fn embedded_refuses_cuda() {
        let error = Runtime::resolve(RuntimeChoice::Embedded, Device::Cuda).unwrap_err();
        assert!(error.to_string().contains("CPU only"), "{error}");
    }

    #[test]
    fn the_provider_is_what_the_library_reports() {
        if let setup::Availability::Unavailable(reason) = setup::ensure_runtime() {
            eprintln!("skipped: {reason}");
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
            native::providers_of(&session),
            [("CPUExecutionProvider".to_owned(), 1)]
        );
    }

    #[test]
    fn several_providers_are_all_named() {
        let text = provider_text(
            &[
                ("CPUExecutionProvider".to_owned(), 2),
                ("CUDAExecutionProvider".to_owned(), 90),
            ],
            Device::Cuda,
        );
        assert_eq!(
            text,
            "CPUExecutionProvider (2 nodes) + CUDAExecutionProvider (90 nodes)"
        );
        assert_eq!(provider_text(&[], Device::Cpu), "CPUExecutionProvider");
    }
}
