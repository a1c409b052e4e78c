//! NumPy arrays from and to the library's vectors.

use numpy::ndarray::Dimension;
use numpy::{Element, PyArray, PyArray1, PyArrayMethods as _, PyReadonlyArray2};
use pyo3::Bound;
use pyo3::prelude::*;
use springtwin::signal::Pose;

use crate::error::Error;

/// Rows of an array with `K` columns; without a copy of more than a row at a time.
///
/// # Errors
/// When it has another number of columns.
pub fn rows<const K: usize>(
    array: &PyReadonlyArray2<'_, f64>,
    what: &str,
) -> PyResult<Vec<[f64; K]>> {
    let view = array.as_array();
    if view.ncols() != K {
        return Err(Error::new_err(format!(
            "{what} has {} columns: give {K}",
            view.ncols()
        )));
    }
    let row = |r: numpy::ndarray::ArrayView1<'_, f64>| std::array::from_fn(|k| r[k]);
    Ok(view.outer_iter().map(row).collect())
}

/// Numbers in row-major order as an array of that shape; the memory is handed over.
pub fn shaped<'py, T: Element, D: Dimension>(
    py: Python<'py>,
    values: Vec<T>,
    shape: impl numpy::ndarray::IntoDimension<Dim = D>,
) -> PyResult<Bound<'py, PyArray<T, D>>> {
    PyArray1::from_vec(py, values).reshape(shape)
}

/// A pose as seven numbers: position x, y, z (m), then the unit quaternion w, x, y, z.
pub fn pose_values(pose: &Pose) -> [f64; 7] {
    let (p, q) = (pose.translation.vector, pose.rotation.coords);
    // One of the two quaternions of a rotation: the one whose w is not negative.
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let [x, y, z, w] = [q.x, q.y, q.z, q.w].map(|c| sign * c);
    [p.x, p.y, p.z, w, x, y, z]
}

/// Rows of numbers one after the other.
pub fn flat<const K: usize>(rows: impl IntoIterator<Item = [f64; K]>) -> Vec<f64> {
    rows.into_iter().flatten().collect()
}
