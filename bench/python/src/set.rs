//! A prepared set as data for training and validation.

use std::path::PathBuf;

use numpy::Element;
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use strat_bench::evaluate::sample::{SampleError, checked_bytes};
use strat_splits::Role;
use strat_store::layout::DepthKind;
use strat_store::set::{FileRef, PreparedSet, Sample};
use strat_store::{exr, image_files};

use crate::arrays::{of_image, of_values};
use crate::errors::raised;

/// A finished prepared set.
#[pyclass(frozen, module = "strat._strat")]
pub struct Set {
    set: PreparedSet,
    /// By role, in the order of [`Role::ALL`].
    samples: Vec<(Role, Vec<Sample>)>,
}

#[pymethods]
impl Set {
    #[new]
    fn new(py: Python<'_>, root: PathBuf) -> PyResult<Self> {
        py.detach(|| {
            let set = PreparedSet::open(&root).map_err(raised)?;
            let samples = Role::ALL.into_iter();
            let samples = samples.map(|role| Ok((role, set.samples(role).map_err(raised)?)));
            let samples = samples.collect::<PyResult<_>>()?;
            Ok(Self { set, samples })
        })
    }

    /// Its content, source and digest.
    fn about(&self) -> (&'static str, &str, &str) {
        let manifest = &self.set.manifest;
        (
            manifest.content.as_str(),
            &manifest.source,
            &manifest.data_digest,
        )
    }

    fn ids(&self, role: &str) -> Vec<&str> {
        self.of(role)
            .iter()
            .map(|sample| sample.id.as_str())
            .collect()
    }

    /// One sample with everything that the set has of it, or with what `only` names; no other file is read.
    #[pyo3(signature = (role, index, only=None))]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        role: &str,
        index: usize,
        only: Option<Vec<String>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let sample = self
            .of(role)
            .get(index)
            .ok_or_else(|| PyIndexError::new_err(format!("no sample {index}")))?;
        let is_wanted = |name: &str| match &only {
            Some(names) => names.iter().any(|own| own == name),
            None => true,
        };
        let item = PyDict::new(py);
        item.set_item("id", &sample.id)?;
        item.set_item("drive", sample.id.split_once('/').map(|(drive, _)| drive))?;
        item.set_item("width", sample.width)?;
        item.set_item("height", sample.height)?;
        item.set_item("focal_px", sample.focal_px)?;
        item.set_item("baseline_m", sample.baseline_m)?;
        for (name, file) in [
            ("left", Some(&sample.left)),
            ("right", sample.right.as_ref()),
            ("image", sample.left_full.as_ref()),
        ] {
            if let Some(file) = file.filter(|_| is_wanted(name)) {
                let image =
                    self.read(py, file, |bytes| image_files::decode_rgb(bytes, &file.path))?;
                item.set_item(name, of_image(py, image)?)?;
            }
        }
        for kind in DepthKind::ALL {
            let name = format!("depth_{}", kind.as_str());
            if let Some(file) = kind.of(sample).filter(|_| is_wanted(&name)) {
                let path = self.set.path(file);
                let (depth, _) = self.read(py, file, |bytes| exr::decode_depth(bytes, &path))?;
                let map = of_values(py, [depth.height, depth.width], depth.data)?;
                item.set_item(name, map)?;
            }
        }
        if let Some(file) = sample.semantic.as_ref().filter(|_| is_wanted("semantic")) {
            let map = self.read(py, file, |bytes| {
                image_files::decode_gray8(bytes, &file.path)
            })?;
            item.set_item("semantic", labels(py, map)?)?;
        }
        if let Some(file) = sample.instance.as_ref().filter(|_| is_wanted("instance")) {
            let map = self.read(py, file, |bytes| {
                image_files::decode_gray16(bytes, &file.path)
            })?;
            item.set_item("instance", labels(py, map)?)?;
        }
        let Some(names) = only else {
            return Ok(item);
        };
        let named = PyDict::new(py);
        for name in names {
            let Some(value) = item.get_item(&name)? else {
                let known: Vec<String> = item.keys().extract()?;
                return Err(PyValueError::new_err(format!(
                    "sample {} has no \"{name}\"; what was asked for and is there: {}",
                    sample.id,
                    known.join(", ")
                )));
            };
            named.set_item(name, value)?;
        }
        Ok(named)
    }
}

impl Set {
    fn of(&self, role: &str) -> &[Sample] {
        let mut samples = self.samples.iter();
        let own = samples.find(|(known, _)| known.as_str() == role);
        own.map_or(&[], |(_, samples)| samples)
    }

    /// Reads and decodes a file, which must be the one that was prepared.
    fn read<T: Send>(
        &self,
        py: Python<'_>,
        file: &FileRef,
        decode: impl FnOnce(&[u8]) -> strat_store::Result<T> + Send,
    ) -> PyResult<T> {
        let read = || -> Result<T, SampleError> { Ok(decode(&checked_bytes(&self.set, file)?)?) };
        py.detach(read).map_err(raised)
    }
}

fn labels<'py, T: Element>(
    py: Python<'py>,
    (width, height, values): (usize, usize, Vec<T>),
) -> PyResult<Bound<'py, PyAny>> {
    of_values(py, [height, width], values)
}
