//! Work of the window on threads of its own.

use springtwin::gui::services::{Job, Worker};

/// Runs `work` on a thread of its own; the window is repainted when the result is there.
pub fn later<T: Send + 'static>(
    ctx: &egui::Context,
    name: &str,
    work: impl FnOnce(&Worker<T>) -> Result<T, String> + Send + 'static,
) -> Job<T> {
    let (job, worker) = Job::pair();
    let ctx = ctx.clone();
    let spawned = std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(move || {
            let answer = work(&worker);
            worker.finish(answer);
            ctx.request_repaint();
        });
    match spawned {
        Ok(_) => job,
        Err(e) => Job::ready(Err(format!("Cannot start a thread for the {name}: {e}."))),
    }
}
