//! Runs a model with rten, a runtime in pure Rust that needs no system library.
//!
//! It is slower than ONNX Runtime (about one and a half times on two CPU threads) and knows the
//! CPU only, but it is always there: `train` measures the parity of its exports with it, and
//! `bench` falls back to it. Results agree with ONNX Runtime to about 1e-7 of full scale.
//!
//! All operators of [`graph`](crate::graph) are in rten's base set, so only its ONNX reader is
//! compiled in; models of others that use random, Fourier or contributed operators are refused
//! when loaded, and so are weights in other files unless these lie directly beside the model and
//! have an extension that begins with `data` or `onnx_data`.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use rten::{Model, ModelOptions, RunOptions, ThreadPool, Value, ValueOrView, ValueView};
use rten_tensor::prelude::*;

use crate::graph::dims_text;
use crate::model::{self, ElementType, ModelInfo, ReadError, TensorInfo};

/// Name, shape and row-major elements of an output.
pub type NamedTensor = (String, Vec<usize>, Vec<f32>);

/// Why the embedded runtime could not load or run a model. `model` names the file.
#[derive(Debug, thiserror::Error)]
pub enum EmbeddedError {
    /// The file was refused before the runtime saw it.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The runtime cannot use the model.
    #[error("the embedded runtime cannot load the model {model}: {reason}")]
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
    #[error("the embedded runtime failed to run the model {model}: {reason}")]
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
}

impl EmbeddedSession {
    /// Reads and checks a file with [`model::read`] and loads it. `threads` limits the run to that
    /// many; `None` uses one thread per physical core, shared by all such sessions.
    ///
    /// # Errors
    /// The file is refused, or uses operators that the runtime does not have.
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
        let model = guarded(|| options.load(bytes)).and_then(|r| r.map_err(|e| e.to_string()));
        let model = model.map_err(fail)?;
        Ok(Self {
            model,
            inputs: info.inputs,
            outputs: info.outputs,
            threads: threads.map(|n| Arc::new(ThreadPool::with_num_threads(n.max(1)))),
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
    /// The name or shape does not fit the model, the model has further inputs, an operator fails,
    /// or an output is not of type `f32`.
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

/// Turns a panic inside the runtime into an error: a model from elsewhere must not end a batch.
fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
        format!(
            "the runtime gave up ({})",
            text.as_deref().unwrap_or("no reason stated")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::guarded;

    #[test]
    fn a_panic_of_the_runtime_becomes_an_error() {
        assert_eq!(guarded(|| 7), Ok(7));
        let text = guarded(|| -> u8 { panic!("index {} out of range", 9) }).unwrap_err();
        assert!(text.contains("index 9 out of range"), "{text}");
    }
}
