//! Work of the window on threads of its own.

use springtwin::gui::services::{Job, Worker};

/// This thread, and those that it starts, leave the processor to the control loop and the link where there are too few for
/// all; elsewhere than on Linux they do not.
pub fn give_way() {
    #[cfg(target_os = "linux")]
    if let Err(e) = rustix::process::setpriority_process(None, 10) {
        log::debug!("long work runs with the priority of all threads: {e}");
    }
}

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
