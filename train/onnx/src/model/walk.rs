//! All nodes and constants of a model: counted, and refused where they would harm a runtime.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::error::ReadError;
use super::external;
use super::info::ElementType;
use crate::proto::{
    AttributeProto, DATA_LOCATION_EXTERNAL, GraphProto, NodeProto, TensorProto, data_type,
};

/// Number of elements of a shape; `None` for negative sizes or more than can be counted.
pub(super) fn elements(dims: &[i64]) -> Option<u64> {
    dims.iter().try_fold(1_u64, |product, &size| {
        product.checked_mul(u64::try_from(size).ok()?)
    })
}

/// Goes through all nodes and constants of a model. The depth is limited by prost, which refuses
/// messages nested more than 100 deep.
pub(super) struct Walk<'a> {
    pub path: &'a Path,
    pub folder: Option<&'a Path>,
    pub operators: BTreeMap<String, u64>,
    pub external_files: BTreeSet<String>,
}

impl Walk<'_> {
    fn refuse(&self, problem: String) -> ReadError {
        ReadError::Unsafe {
            path: self.path.to_owned(),
            problem,
        }
    }

    pub fn graph(&mut self, graph: &GraphProto) -> Result<(), ReadError> {
        for tensor in &graph.initializer {
            self.tensor(tensor)?;
        }
        for sparse in &graph.sparse_initializer {
            for tensor in [&sparse.values, &sparse.indices].into_iter().flatten() {
                self.tensor(tensor)?;
            }
        }
        for node in &graph.node {
            self.node(node)?;
        }
        Ok(())
    }

    pub fn node(&mut self, node: &NodeProto) -> Result<(), ReadError> {
        let op = node.op_type.as_deref().unwrap_or_default();
        let domain = node.domain.as_deref().unwrap_or_default();
        let full_name = match domain {
            "" | "ai.onnx" => op.to_owned(),
            domain => format!("{domain}.{op}"),
        };
        *self.operators.entry(full_name).or_default() += 1;

        let place = format!("{op} node \"{}\"", node.name.as_deref().unwrap_or_default());
        let windowed = op.contains("Conv") || op.contains("Pool");
        for attribute in &node.attribute {
            let name = attribute.name.as_deref().unwrap_or_default();
            let divisors: &[i64] = match name {
                // An attribute that is there without a value counts as zero in every runtime.
                "group" => &[attribute.i.unwrap_or(0)],
                "strides" | "dilations" | "kernel_shape" => &attribute.ints,
                _ => &[],
            };
            let by_reference = attribute
                .ref_attr_name
                .as_deref()
                .is_some_and(|n| !n.is_empty());
            if windowed
                && (divisors.iter().any(|&value| value < 1) || by_reference && name == "group")
            {
                return Err(self.refuse(format!(
                    "the {place} has a \"{name}\" below 1, which crashes runtimes"
                )));
            }
            self.attribute(attribute, &place)?;
        }
        Ok(())
    }

    pub fn attribute(&mut self, attribute: &AttributeProto, place: &str) -> Result<(), ReadError> {
        let sparse = attribute
            .sparse_tensor
            .iter()
            .chain(&attribute.sparse_tensors);
        let parts = sparse
            .flat_map(|sparse| [&sparse.values, &sparse.indices])
            .flatten();
        for tensor in attribute.t.iter().chain(&attribute.tensors).chain(parts) {
            self.tensor_in(tensor, place)?;
        }
        for graph in attribute.g.iter().chain(&attribute.graphs) {
            self.graph(graph)?;
        }
        Ok(())
    }

    fn tensor(&mut self, tensor: &TensorProto) -> Result<(), ReadError> {
        self.tensor_in(tensor, "the graph")
    }

    fn tensor_in(&mut self, tensor: &TensorProto, place: &str) -> Result<(), ReadError> {
        let name = tensor.name.as_deref().unwrap_or_default();
        let constant = || format!("the constant \"{name}\" of {place}");
        let Some(count) = elements(&tensor.dims) else {
            let problem = format!("{} has the impossible shape {:?}", constant(), tensor.dims);
            return Err(self.refuse(problem));
        };
        let kind = ElementType(tensor.data_type.unwrap_or(0));
        let wanted = match kind.bits().map(|bits| count.checked_mul(bits)) {
            Some(Some(bits)) => Some(bits.div_ceil(8)),
            Some(None) => {
                let problem = format!("{} has the impossible shape {:?}", constant(), tensor.dims);
                return Err(self.refuse(problem));
            }
            None => None,
        };
        if tensor.data_location == Some(DATA_LOCATION_EXTERNAL) {
            let found = external::location(tensor, wanted, &constant(), self.folder);
            let location = found.map_err(|problem| ReadError::ExternalData {
                path: self.path.to_owned(),
                problem,
            })?;
            self.external_files.insert(location);
            return Ok(());
        }
        let stored = match (&tensor.raw_data, kind.0) {
            (Some(raw), _) if !raw.is_empty() => wanted.map(|wanted| (wanted, raw.len() as u64)),
            (_, data_type::FLOAT) => Some((count, tensor.float_data.len() as u64)),
            (_, data_type::INT64) => Some((count, tensor.int64_data.len() as u64)),
            (_, data_type::DOUBLE) => Some((count, tensor.double_data.len() as u64)),
            (_, data_type::INT32 | data_type::INT8 | data_type::UINT8 | data_type::BOOL) => {
                Some((count, tensor.int32_data.len() as u64))
            }
            _ => None,
        };
        match stored {
            Some((wanted, found)) if wanted != found => Err(self.refuse(format!(
                "{} has shape {:?} but {found} of {wanted} units of data",
                constant(),
                tensor.dims
            ))),
            _ => Ok(()),
        }
    }
}
