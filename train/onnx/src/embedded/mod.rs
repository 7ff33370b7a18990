//! Runs a model with rten, a runtime in pure Rust that needs no system library.
//!
//! It is slower than ONNX Runtime (about one and a half times on two CPU threads) and knows the
//! CPU only, but it is always there: `train` measures the parity of its exports with it, and
//! `bench` falls back to it. Results agree with ONNX Runtime to about 1e-7 of full scale.
//!
//! It computes what ONNX defines or refuses: `forms` lists the operators and attributes that were held
//! against ONNX Runtime, `sizes` follows the shapes before anything is allocated, and a panic inside the
//! runtime is an error like any other.
//!
//! All operators of [`graph`](crate::graph) are in rten's base set, so only its ONNX reader is
//! compiled in; models of others that use random, Fourier or contributed operators are refused
//! when loaded, and so are weights in other files unless these lie directly beside the model and
//! have an extension that begins with `data` or `onnx_data`.

mod forms;
mod shapes;
mod sizes;

use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Once, PoisonError};

use prost::Message;
use prost::bytes::Bytes;

use rten::{Model, ModelOptions, RunOptions, ThreadPool, Value, ValueOrView, ValueView};
use rten_tensor::prelude::*;

use self::sizes::Sizes;
use crate::graph::dims_text;
use crate::model::{self, ElementType, ModelInfo, ReadError, TensorInfo};
use crate::proto::{GraphProto, ModelProto};

/// Name, shape and row-major elements of an output.
pub type NamedTensor = (String, Vec<usize>, Vec<f32>);

/// Why the embedded runtime could not load or run a model. `model` names the file.
#[derive(Debug, thiserror::Error)]
pub enum EmbeddedError {
    /// The file was refused before the runtime saw it.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The model asks for more than this runtime computes.
    #[error(
        "the embedded runtime does not compute the model {model} as ONNX defines it: {reason}; use ONNX \
         Runtime, which `bench setup` installs"
    )]
    Unsupported {
        /// The file.
        model: String,
        /// The node or constant, and what about it.
        reason: String,
    },
    /// A value of the model is larger than this runtime allocates.
    #[error("the embedded runtime does not run the model {model}: {reason}")]
    TooLarge {
        /// The file.
        model: String,
        /// Which value, and its size.
        reason: String,
    },
    /// The runtime cannot use the model.
    #[error(
        "the embedded runtime cannot load the model {model}: {reason}; ONNX Runtime may, which \
         `bench setup` installs"
    )]
    Load {
        /// The file.
        model: String,
        /// What the runtime said.
        reason: String,
    },
    /// The input does not fit the model.
    #[error("the input for the model {model} does not fit: {reason}")]
    Input {
        /// The file.
        model: String,
        /// What does not fit.
        reason: String,
    },
    /// The run failed.
    #[error(
        "the embedded runtime failed to run the model {model}: {reason}; ONNX Runtime may, which \
         `bench setup` installs"
    )]
    Run {
        /// The file.
        model: String,
        /// What the runtime said.
        reason: String,
    },
}

/// A loaded model. Runs may be made from several threads at once; they share one thread pool.
pub struct EmbeddedSession {
    name: String,
    model: Model,
    inputs: Vec<TensorInfo>,
    outputs: Vec<TensorInfo>,
    threads: Option<Arc<ThreadPool>>,
    sizes: Sizes,
    /// Shape of the input that was checked last.
    checked: Mutex<Vec<usize>>,
}

impl EmbeddedSession {
    /// Reads and checks a file with [`model::read`] and loads it. `threads` limits the run to that
    /// many; `None` uses one thread per physical core, shared by all such sessions.
    ///
    /// # Errors
    /// The file is refused, or has operator forms that the runtime does not compute.
    pub fn load(path: impl AsRef<Path>, threads: Option<usize>) -> Result<Self, EmbeddedError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let (file, bytes) = model::read_with_bytes(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut options = ModelOptions::with_all_ops();
        for location in &file.info.external_files {
            let file = folder.join(location);
            let content = fs_err::read(&file).map_err(|error| EmbeddedError::Load {
                model: name.clone(),
                reason: error.to_string(),
            })?;
            options.external_data(location, content);
        }
        Self::open(name, file.info, bytes, &options, threads)
    }

    /// As [`load`](Self::load), from memory; `name` stands for the file in messages.
    ///
    /// # Errors
    /// As [`load`](Self::load); weights in other files are refused.
    pub fn from_bytes(
        bytes: Vec<u8>,
        name: &str,
        threads: Option<usize>,
    ) -> Result<Self, EmbeddedError> {
        let (info, bytes) = model::inspect_owned(bytes, name)?;
        let options = ModelOptions::with_all_ops();
        Self::open(name.to_owned(), info, bytes, &options, threads)
    }

    fn open(
        name: String,
        info: ModelInfo,
        bytes: Vec<u8>,
        options: &ModelOptions,
        threads: Option<usize>,
    ) -> Result<Self, EmbeddedError> {
        let fail = |reason: String| EmbeddedError::Load {
            model: name.clone(),
            reason,
        };
        let bytes = Bytes::from(bytes);
        let proto = ModelProto::decode(bytes.clone()).map_err(|error| fail(error.to_string()))?;
        forms::check(&proto).map_err(|reason| EmbeddedError::Unsupported {
            model: name.clone(),
            reason,
        })?;
        let sizes = Sizes::new(proto.graph.as_ref().unwrap_or(&GraphProto::default()));
        drop(proto);
        let bytes = Vec::from(bytes);
        let model = guarded(|| options.load(bytes)).and_then(|r| r.map_err(|e| e.to_string()));
        let model = model.map_err(fail)?;
        Ok(Self {
            model,
            inputs: info.inputs,
            outputs: info.outputs,
            threads: threads.map(|n| Arc::new(ThreadPool::with_num_threads(n.max(1)))),
            sizes,
            checked: Mutex::default(),
            name,
        })
    }

    /// The inputs that must be fed.
    #[must_use]
    pub fn inputs(&self) -> &[TensorInfo] {
        &self.inputs
    }

    /// The outputs in the order in which [`run`](Self::run) returns them.
    #[must_use]
    pub fn outputs(&self) -> &[TensorInfo] {
        &self.outputs
    }

    /// Runs the model on one `f32` input, row-major, and returns all outputs.
    ///
    /// Values are returned as the model gives them: what is not finite is the caller's to notice.
    ///
    /// # Errors
    /// The name or shape does not fit the model, the model has further inputs, a value would be too
    /// large, an operator fails, or an output is not of type `f32`.
    pub fn run(
        &self,
        input: &str,
        shape: &[usize],
        data: &[f32],
    ) -> Result<Vec<NamedTensor>, EmbeddedError> {
        let misfit = |reason: String| EmbeddedError::Input {
            model: self.name.clone(),
            reason,
        };
        self.check_input(input, shape, data).map_err(misfit)?;
        self.check_sizes(input, shape)?;
        let fail = |reason: String| EmbeddedError::Run {
            model: self.name.clone(),
            reason,
        };
        let input_id = self
            .model
            .node_id(input)
            .map_err(|error| fail(error.to_string()))?;
        let view = ValueView::from_shape(shape, data).map_err(|error| misfit(error.to_string()))?;
        let mut options = RunOptions::default();
        options.thread_pool.clone_from(&self.threads);
        let mut outputs = Vec::with_capacity(self.outputs.len());
        for output in &self.outputs {
            outputs.push(
                self.model
                    .node_id(&output.name)
                    .map_err(|error| fail(error.to_string()))?,
            );
        }
        let inputs = vec![(input_id, ValueOrView::from(view))];
        let values = guarded(|| self.model.run(inputs, &outputs, Some(options)))
            .and_then(|r| r.map_err(|e| e.to_string()))
            .map_err(fail)?;
        let named = self.outputs.iter().zip(values).map(|(output, value)| {
            let kind = value.dtype();
            let Value::FloatTensor(tensor) = value else {
                return Err(fail(format!(
                    "the output \"{}\" is {kind}, not f32",
                    output.name
                )));
            };
            Ok((
                output.name.clone(),
                tensor.shape().to_vec(),
                tensor.into_data(),
            ))
        });
        named.collect()
    }

    /// Follows the sizes of all values, once for each shape of the input.
    fn check_sizes(&self, input: &str, shape: &[usize]) -> Result<(), EmbeddedError> {
        let mut checked = self.checked.lock().unwrap_or_else(PoisonError::into_inner);
        if *checked != shape {
            let found = self.sizes.check(input, shape);
            found.map_err(|reason| EmbeddedError::TooLarge {
                model: self.name.clone(),
                reason,
            })?;
            *checked = shape.to_vec();
        }
        Ok(())
    }

    fn check_input(&self, input: &str, shape: &[usize], data: &[f32]) -> Result<(), String> {
        let names: Vec<&str> = self.inputs.iter().map(|info| info.name.as_str()).collect();
        let Some(info) = self.inputs.iter().find(|info| info.name == input) else {
            return Err(format!(
                "it has no input \"{input}\"; its inputs are {names:?}"
            ));
        };
        if self.inputs.len() != 1 {
            return Err(format!("one input was given, it needs {names:?}"));
        }
        if let Some(element) = info.element.filter(|&element| element != ElementType::F32) {
            return Err(format!("\"{input}\" takes {element}, f32 was given"));
        }
        let fits = info.dims.as_ref().is_none_or(|dims| {
            dims.len() == shape.len()
                && dims
                    .iter()
                    .zip(shape)
                    .all(|(dim, size)| dim.fixed().is_none_or(|d| d == *size))
        });
        if !fits {
            let dims = info.dims.as_deref().map(dims_text).unwrap_or_default();
            return Err(format!("\"{input}\" has shape {dims}, {shape:?} was given"));
        }
        let count = shape
            .iter()
            .try_fold(1_usize, |product, &size| product.checked_mul(size));
        match count {
            Some(0) | None => Err(format!("{shape:?} is not a shape that can be run")),
            Some(count) if count != data.len() => Err(format!(
                "{shape:?} needs {count} values, {} were given",
                data.len()
            )),
            Some(_) => Ok(()),
        }
    }
}

/// Calls into the runtime that are going on.
static GUARDED: AtomicUsize = AtomicUsize::new(0);

/// Turns a panic inside the runtime into an error: a model from elsewhere must not end a batch.
fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    silence();
    GUARDED.fetch_add(1, Ordering::SeqCst);
    let done = catch_unwind(AssertUnwindSafe(work));
    GUARDED.fetch_sub(1, Ordering::SeqCst);
    done.map_err(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
        format!(
            "the runtime gave up ({})",
            text.as_deref().unwrap_or("no reason stated")
        )
    })
}

/// Keeps the trace of a panic inside the runtime off the terminal: it becomes a sentence. The runtime
/// panics on threads of its own too, so the place of the panic decides; all others are told as before.
fn silence() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info: &PanicHookInfo| {
            let guarded = GUARDED.load(Ordering::SeqCst) > 0;
            let file = info.location().map_or("", |place| place.file());
            if !(guarded && file.contains("rten")) {
                before(info);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::proto::{AttributeProto, NodeProto, OperatorSetIdProto, TensorProto, data_type};

    #[test]
    fn a_panic_of_the_runtime_becomes_an_error() {
        assert_eq!(guarded(|| 7), Ok(7));
        let text = guarded(|| -> u8 { panic!("index {} out of range", 9) }).unwrap_err();
        assert!(text.contains("index 9 out of range"), "{text}");
    }

    fn tensor(name: &str, numbers: &[i64]) -> TensorProto {
        TensorProto {
            name: Some(name.to_owned()),
            dims: vec![numbers.len() as i64],
            data_type: Some(data_type::INT64),
            int64_data: numbers.to_vec(),
            ..TensorProto::default()
        }
    }

    fn node(op: &str, inputs: &[&str], output: &str) -> NodeProto {
        NodeProto {
            name: Some(output.to_owned()),
            op_type: Some(op.to_owned()),
            input: inputs.iter().map(|name| (*name).to_owned()).collect(),
            output: vec![output.to_owned()],
            ..NodeProto::default()
        }
    }

    fn sizes(constants: &[TensorProto], nodes: &[NodeProto]) -> Result<(), String> {
        let graph = GraphProto {
            initializer: constants.to_vec(),
            node: nodes.to_vec(),
            ..GraphProto::default()
        };
        Sizes::new(&graph).check("x", &[1, 3, 64, 128])
    }

    #[test]
    fn what_would_be_too_large_is_refused_before_it_is_allocated() {
        let million = tensor("million", &[1_000_000, 1_000_000]);
        let made = node("ConstantOfShape", &["million"], "made");
        let text = sizes(&[million], std::slice::from_ref(&made)).unwrap_err();
        assert!(
            text.contains("ConstantOfShape") && text.contains("made"),
            "{text}"
        );
        assert_eq!(sizes(&[tensor("million", &[1000, 1000])], &[made]), Ok(()));
        // By way of arithmetic on the shape of the input: 64 * 2^20.
        let constants = [
            tensor("row", &[2]),
            tensor("factor", &[1 << 20]),
            tensor("one", &[1]),
        ];
        let nodes = [
            node("Shape", &["x"], "shape"),
            node("Gather", &["shape", "row"], "height"),
            node("Mul", &["height", "factor"], "rows"),
            node("Concat", &["one", "rows", "rows"], "wanted"),
            node("Expand", &["x", "wanted"], "grown"),
        ];
        let text = sizes(&constants, &nodes).unwrap_err();
        assert!(text.contains("67108864"), "{text}");
        let text = sizes(
            &[tensor("times", &[1, 1, 30_000, 30_000])],
            &[node("Tile", &["x", "times"], "t")],
        );
        assert!(text.unwrap_err().contains("Tile"));
        // An outer product.
        let nodes = [
            node("Reshape", &["x", "column"], "a"),
            node("Transpose", &["a"], "b"),
            node("MatMul", &["a", "b"], "c"),
            node("Reshape", &["c", "column"], "d"),
        ];
        assert_eq!(sizes(&[tensor("column", &[-1, 1])], &nodes), Ok(()));
        let nodes = [
            &nodes[..],
            &[
                node("Transpose", &["d"], "e"),
                node("MatMul", &["d", "e"], "f"),
            ],
        ]
        .concat();
        let text = sizes(&[tensor("column", &[-1, 1])], &nodes).unwrap_err();
        assert!(text.contains("MatMul node \"f\""), "{text}");
        let huge = Sizes::new(&GraphProto::default()).check("x", &[1, 3, 100_000, 100_000]);
        assert!(huge.unwrap_err().contains("the input"));
    }

    #[test]
    fn a_form_that_is_not_listed_is_refused_with_the_remedy() {
        let with = |name: &str, word: &str| AttributeProto {
            name: Some(name.to_owned()),
            s: Some(word.as_bytes().to_vec().into()),
            ..AttributeProto::default()
        };
        let mut resize = node("Resize", &["x", "", "scales"], "y");
        resize.attribute = vec![with("mode", "cubic")];
        let model = |opset, nodes: &[NodeProto]| ModelProto {
            opset_import: vec![OperatorSetIdProto {
                domain: None,
                version: Some(opset),
            }],
            graph: Some(GraphProto {
                node: nodes.to_vec(),
                ..GraphProto::default()
            }),
            ..ModelProto::default()
        };
        let refused = |opset, node: &NodeProto| {
            forms::check(&model(opset, std::slice::from_ref(node))).unwrap_err()
        };
        assert_eq!(
            refused(17, &resize),
            "its Resize node \"y\" has mode = cubic"
        );
        resize.attribute = vec![with("mode", "linear")];
        assert!(refused(10, &resize).contains("before 11"));
        assert_eq!(forms::check(&model(17, &[resize.clone()])), Ok(()));
        assert!(refused(6, &resize).contains("version 6"));
        resize.attribute = vec![with("sharpness", "much")];
        assert!(refused(17, &resize).contains("sharpness = much"));
        assert!(refused(17, &node("Loop", &[], "y")).contains("Loop"));
        let mut foreign = node("Relu", &["x"], "y");
        foreign.domain = Some("com.microsoft".to_owned());
        assert!(refused(17, &foreign).contains("com.microsoft"));
    }
}
