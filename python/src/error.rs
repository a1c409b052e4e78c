//! Errors of the library as one Python exception.

use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::PyException;

create_exception!(
    springtwin,
    Error,
    PyException,
    "What the library refuses or cannot do, in one sentence: what happened, where, and what to do."
);

/// An error of the library, with what it was about in front.
pub fn refused(error: impl Into<anyhow::Error>) -> PyErr {
    Error::new_err(format!("{:#}", error.into()))
}
