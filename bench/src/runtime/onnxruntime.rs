//! ONNX Runtime in this process: its library, its providers, its messages made readable.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use half::f16;
use ort::value::{TensorElementType, TensorRef};
use strat_onnx::embedded::NamedTensor;
use strat_store::{command::eprint_line, guard::guarded};

use super::{
    device::Device,
    error::RuntimeError,
    ffi,
    search::{self, SearchPaths},
};

/// ONNX Runtime as loaded into this process.
pub(super) struct Loaded {
    environment: ort::environment::Environment,
    pub(super) library: PathBuf,
    pub(super) version: String,
}

/// Loads ONNX Runtime into the process, once: a process can have one environment only.
pub(super) fn find(prefer_gpu: bool) -> Result<&'static Loaded, RuntimeError> {
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
    for candidate in SearchPaths::of_this_process().candidates(prefer_gpu) {
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
                eprint_line(format_args!("onnxruntime: {message}"));
            }
        }))
        .build()
        .map_err(|error| error.message().to_owned())?;
    environment.set_log_level(ort::logging::LogLevel::Warning);
    if let Some((toolkit, cudnn)) = search::cuda_folders(library) {
        // Those that matter are opened; what is missing shows when the CUDA provider starts.
        let _ = ort::ep::cuda::preload_dylibs(Some(&toolkit), Some(&cudnn));
    }
    Ok(environment)
}

/// Whether the loaded library knows the provider; not whether the provider can start.
pub(super) fn is_compiled_in(device: Device) -> bool {
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

pub(super) fn load(
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

/// Why a run gave nothing.
pub(super) enum RunError {
    /// In the runtime's words.
    Failed(ort::Error),
    /// The binding panicked, in a sentence.
    Panicked(String),
    /// An output of a type that is not read.
    Type {
        /// The output.
        name: String,
        /// Its type.
        found: String,
    },
}

impl From<ort::Error> for RunError {
    fn from(error: ort::Error) -> Self {
        Self::Failed(error)
    }
}

/// Runs a session on one input, converted to the type that it takes, and names all outputs; the `wanted`
/// one has its values, as `f32`.
pub(super) fn run(
    session: &mut ort::session::Session,
    input: &str,
    shape: [usize; 4],
    data: &[f32],
    wanted: &str,
) -> Result<Vec<NamedTensor>, RunError> {
    let known = session.inputs().iter().find(|known| known.name() == input);
    let element = known.and_then(|known| known.dtype().tensor_type());
    let (halves, bytes): (Vec<f16>, Vec<u8>);
    let inputs = match element {
        Some(TensorElementType::Float16) => {
            halves = data.iter().map(|value| f16::from_f32(*value)).collect();
            ort::inputs![input => TensorRef::from_array_view((shape, halves.as_slice()))?]
        }
        Some(TensorElementType::Uint8) => {
            // Rounded here, and kept within the range by the conversion.
            bytes = data.iter().map(|value| value.round() as u8).collect();
            ort::inputs![input => TensorRef::from_array_view((shape, bytes.as_slice()))?]
        }
        _ => ort::inputs![input => TensorRef::from_array_view((shape, data))?],
    };
    let outputs = guarded("its binding", || session.run(inputs));
    let outputs = outputs.map_err(RunError::Panicked)??;
    let named = outputs.iter().map(|(name, value)| {
        let is_wanted = name == wanted;
        let (shape, data) = match value.dtype().tensor_type() {
            Some(TensorElementType::Float32) => {
                let (shape, data) = value.try_extract_tensor::<f32>()?;
                (shape, if is_wanted { data.to_vec() } else { Vec::new() })
            }
            Some(TensorElementType::Float16) if is_wanted => {
                let (shape, data) = value.try_extract_tensor::<f16>()?;
                (shape, data.iter().map(|value| value.to_f32()).collect())
            }
            Some(TensorElementType::Uint8) if is_wanted => {
                let (shape, data) = value.try_extract_tensor::<u8>()?;
                (shape, data.iter().map(|value| f32::from(*value)).collect())
            }
            // What else a model gives is nobody's.
            _ if !is_wanted => return Ok((name.to_owned(), Vec::new(), Vec::new())),
            _ => {
                return Err(RunError::Type {
                    name: name.to_owned(),
                    found: value.dtype().to_string(),
                });
            }
        };
        // A tensor that exists has no negative dimension.
        let shape = shape.iter().map(|&size| usize::try_from(size).unwrap_or(0));
        Ok((name.to_owned(), shape.collect(), data))
    });
    named.collect()
}

/// Names the providers that hold nodes; the counts only where there is more than one.
pub(super) fn provider_text(assigned: &[(String, usize)], device: Device) -> String {
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
pub(super) fn shorten(message: &str) -> String {
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
}
