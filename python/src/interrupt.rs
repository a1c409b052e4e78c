//! Ctrl-C in long work, and its progress.

use std::sync::Mutex;

use pyo3::prelude::*;
use springtwin::gap::{GapError, Progress, Stage};

/// Progress of the gap finder to a Python callable, if there is one; a signal or an exception of the callable ends the work.
pub struct Watched {
    callable: Option<Py<PyAny>>,
    raised: Mutex<Option<PyErr>>,
}

impl Watched {
    /// `callable` takes what is being done (a few words) and the share of it that is done, 0 to 1; `None`: nobody looks.
    pub fn new(callable: Option<Py<PyAny>>) -> Self {
        Self {
            callable,
            raised: Mutex::new(None),
        }
    }

    /// The exception that ended the work in the place of the library's own error.
    pub fn or_raised(&self, error: impl Into<anyhow::Error>) -> PyErr {
        let raised = self.raised.lock().ok().and_then(|mut r| r.take());
        let raised = raised.or_else(crate::own::raised);
        raised.unwrap_or_else(|| crate::error::refused(error))
    }
}

impl Progress for Watched {
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError> {
        let seen = Python::attach(|py| {
            py.check_signals()?;
            if let Some(callable) = &self.callable {
                callable.call1(py, (stage.name(), share))?;
            }
            Ok(())
        });
        if crate::own::has_raised() {
            return Err(GapError::Stopped);
        }
        seen.map_err(|e: PyErr| {
            if let Ok(mut raised) = self.raised.lock() {
                raised.get_or_insert(e);
            }
            GapError::Stopped
        })
    }
}
