//! The extension module `springtwin._springtwin`: the library's functions on NumPy arrays and paths.
//!
//! It computes nothing of its own. Arrays come in and go out in SI units and in the frames and orders of the guide's page of
//! conventions; the Python files beside it (`python/springtwin`) shape them, name them and document them. Whatever takes
//! longer than a conversion runs without the interpreter's lock, and an error of the library is `springtwin.Error` with the
//! library's sentence.

mod arrays;
mod error;
mod gap;
mod interrupt;
mod own;
mod places;
mod rig;
mod robot;
mod session;
mod twin;

use pyo3::prelude::*;

/// Functions and classes of the extension module.
#[pymodule]
fn _springtwin(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Error", module.py().get_type::<error::Error>())?;
    module.add_class::<robot::Robot>()?;
    module.add_class::<rig::Rig>()?;
    module.add_class::<twin::Twin>()?;
    module.add_class::<own::OwnEffect>()?;
    for function in [
        wrap_pyfunction!(rig::hidden_effects, module)?,
        wrap_pyfunction!(session::read_session, module)?,
        wrap_pyfunction!(session::simulate_session, module)?,
        wrap_pyfunction!(session::estimate, module)?,
        wrap_pyfunction!(session::replay, module)?,
        wrap_pyfunction!(gap::effects, module)?,
        wrap_pyfunction!(gap::commission, module)?,
        wrap_pyfunction!(gap::find, module)?,
        wrap_pyfunction!(gap::discover, module)?,
        wrap_pyfunction!(gap::apply_patch, module)?,
        wrap_pyfunction!(gap::revert_patch, module)?,
        wrap_pyfunction!(gap::write_file, module)?,
    ] {
        module.add_function(function)?;
    }
    Ok(())
}
