//! Between NumPy's arrays and planes. What is used while no lock of the interpreter is held is copied, so
//! that Python may go on with its own.

use image::RgbImage;
use numpy::ndarray::Array;
use numpy::{IntoPyArray as _, PyReadonlyArray2, PyUntypedArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strat_store::raster::Plane;

/// Values row by row of an array of rows and columns.
pub fn values<T: numpy::Element + Copy>(array: &PyReadonlyArray2<'_, T>) -> Vec<T> {
    match array.as_slice() {
        Ok(values) => values.to_vec(),
        Err(_) => array.as_array().iter().copied().collect(),
    }
}

/// The values row by row, where they lie, while the interpreter is held.
pub fn contiguous<'a>(array: &'a PyReadonlyArray2<'_, f32>) -> PyResult<&'a [f32]> {
    let values = array.as_slice();
    values.map_err(|_| PyValueError::new_err("its values do not lie row by row"))
}

/// Columns and rows.
pub fn size<T: numpy::Element>(array: &PyReadonlyArray2<'_, T>) -> (usize, usize) {
    let shape = array.shape();
    (shape[1], shape[0])
}

/// A map of at least one value.
pub fn plane(array: &PyReadonlyArray2<'_, f32>) -> PyResult<Plane> {
    let (width, height) = size(array);
    if width == 0 || height == 0 {
        return Err(PyValueError::new_err(format!(
            "its shape is [{height}, {width}]; a map without values cannot be scored"
        )));
    }
    Ok(Plane {
        width,
        height,
        data: values(array),
    })
}

/// An array of rows, columns and the channels R, G, B.
pub fn of_image<'py>(py: Python<'py>, image: RgbImage) -> PyResult<Bound<'py, PyAny>> {
    let shape = [image.height() as usize, image.width() as usize, 3];
    of_values(py, shape, image.into_raw())
}

/// An array of a shape.
pub fn of_values<'py, T: numpy::Element, const N: usize>(
    py: Python<'py>,
    shape: [usize; N],
    values: Vec<T>,
) -> PyResult<Bound<'py, PyAny>> {
    let array = Array::from_shape_vec(shape.to_vec(), values);
    let array = array.map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(array.into_pyarray(py).into_any())
}
