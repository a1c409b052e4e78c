//! Work beside a control loop that goes on.

use std::sync::mpsc::{Receiver, sync_channel};

use crate::drive::give_way;

/// Does `work` on a thread of its own, which leaves the processor to the control loop; where its result arrives.
///
/// # Errors
/// When there is no thread for it.
pub fn beside<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> std::io::Result<Receiver<T>> {
    let (tx, result) = sync_channel(1);
    let work = move || {
        give_way();
        // Nobody may be waiting by then.
        let _ = tx.try_send(work());
    };
    let thread = std::thread::Builder::new().name("calibration".to_owned());
    thread.spawn(work)?;
    Ok(result)
}
