//! The window's graphics device, and a new window when the device is lost. The twin ticks on meanwhile.

use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::rc::Rc;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, bail};
use eframe::CreationContext;
use egui_wgpu::{RenderState, WgpuSetup, WgpuSetupCreateNew};
use springtwin::gui::App;

use super::settings::Settings;

/// A device that is lost sooner than this is not trusted again.
const STEADY: Duration = Duration::from_secs(60);
/// So many losses one soon after the other end the window.
const LOSSES: u32 = 3;

/// Makes the app on the first device.
pub type Begin<'a> = Box<dyn FnOnce(&CreationContext<'_>) -> Result<App> + 'a>;

/// Which adapters a window may be drawn with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Adapters {
    /// What the system recommends.
    Any,
    /// Those that draw on the processor.
    Software,
}

/// What outlives a device.
struct Kept {
    app: App,
    ctx: egui::Context,
    /// Time of the window when it was painted last, s.
    time_s: f64,
}

/// What happens to the device that is in use: why it is gone, once it is.
type Lost = Arc<OnceLock<String>>;

/// How a window ended.
enum End {
    /// The operator closed it.
    Closed,
    /// Its device is gone, for this reason.
    Lost(String),
    /// There is no device that can draw it.
    NoDevice(String),
    /// It could not be opened for another reason.
    Failed(String),
}

/// Shows the window until the operator closes it, on another device when its own is lost.
///
/// # Errors
/// When there is no device to begin with, or none that keeps working. `drill`: when the devices are lost on purpose.
pub fn show(
    options: &dyn Fn() -> eframe::NativeOptions,
    begin: Begin<'_>,
    settings: Option<Settings>,
    drill: &[Duration],
) -> Result<()> {
    let settings = settings.map(Rc::new);
    let options = || eframe::NativeOptions {
        persistence_path: settings.as_ref().map(|s| s.own().to_owned()),
        ..options()
    };
    let kept: Rc<RefCell<Option<Kept>>> = Rc::default();
    let mut begin = Some(begin);
    let mut order = [Adapters::Any, Adapters::Software];
    let mut losses = 0;
    loop {
        let opened = now();
        let mut end = End::Closed;
        let mut first_failure = None;
        for adapters in order {
            end = run(options(), adapters, &mut begin, &kept, &settings, drill);
            if let Some(settings) = &settings {
                settings.publish();
            }
            let End::NoDevice(e) = &end else {
                break;
            };
            log::info!("no window with {adapters:?} adapters: {e}");
            first_failure.get_or_insert(e.clone());
        }
        let reason = match (end, first_failure) {
            (End::Closed, _) => return Ok(()),
            (End::Lost(reason), _) => reason,
            (End::NoDevice(_), Some(e)) | (End::NoDevice(e) | End::Failed(e), _) => {
                if losses > 0 {
                    return Err(gone(&e));
                }
                bail!(
                    "the window cannot be opened ({e}): use `springtwin run --headless`, or see `springtwin doctor`"
                );
            }
        };
        let steady = opened.elapsed() >= STEADY;
        losses = if steady { 1 } else { losses + 1 };
        if losses > LOSSES {
            return Err(gone(&reason));
        }
        log::warn!(
            "the graphics device was lost ({reason}): the twin goes on, and the window opens again on another"
        );
        order = match losses {
            1 => [Adapters::Any, Adapters::Software],
            _ => [Adapters::Software, Adapters::Any],
        };
    }
}

fn gone(reason: &str) -> anyhow::Error {
    anyhow!(
        "the graphics device was lost and the window does not come back ({reason}): the arm was let go as when the window is closed; use `springtwin run --headless`, or see `springtwin doctor`"
    )
}

#[expect(
    clippy::disallowed_methods,
    reason = "how long a device lasts is real time"
)]
fn now() -> Instant {
    Instant::now()
}

/// One window on one device.
fn run(
    mut options: eframe::NativeOptions,
    adapters: Adapters,
    begin: &mut Option<Begin<'_>>,
    kept: &Rc<RefCell<Option<Kept>>>,
    settings: &Option<Rc<Settings>>,
    drill: &[Duration],
) -> End {
    let lost = Lost::default();
    let closed_by_loss = Rc::new(Cell::new(false));
    options.run_and_return = true;
    if adapters == Adapters::Software {
        options.wgpu_options.wgpu_setup = software();
    }
    let ctx = kept.borrow().as_ref().map(|k| k.ctx.clone());
    let create: eframe::AppCreator<'_> = {
        let (lost, kept, closed_by_loss) =
            (lost.clone(), Rc::clone(kept), Rc::clone(&closed_by_loss));
        Box::new(move |cc| {
            if let Some(rs) = &cc.wgpu_render_state {
                watch(rs, &lost, &cc.egui_ctx);
            }
            if let Some(begin) = begin.take() {
                let app = begin(cc)?;
                *kept.borrow_mut() = Some(Kept {
                    app,
                    ctx: cc.egui_ctx.clone(),
                    time_s: 0.0,
                });
            } else if let Some(kept) = &mut *kept.borrow_mut() {
                let told = "The graphics device was lost: the window was opened again on another.";
                kept.app
                    .change_device(&kept.ctx, cc.wgpu_render_state.as_ref(), told);
            }
            let begins_s = kept.borrow().as_ref().map_or(0.0, |k| k.time_s);
            Ok(Box::new(Pane {
                kept,
                settings: settings.clone(),
                lost,
                closed_by_loss,
                begins_s,
                drill: drill.iter().map(Duration::as_secs_f64).collect(),
                shown: Shown::Nothing,
            }))
        })
    };
    let shown = catch_unwind(AssertUnwindSafe(|| {
        eframe::run_native_ext("springtwin", options, ctx, create)
    }));
    let reason = || lost.get().cloned().unwrap_or_default();
    match shown {
        _ if closed_by_loss.get() => End::Lost(reason()),
        Ok(Ok(())) => End::Closed,
        // What draws may panic between the loss and our next look.
        Ok(Err(_)) | Err(_) if lost.get().is_some() && kept.borrow().is_some() => {
            End::Lost(reason())
        }
        Ok(Err(eframe::Error::Wgpu(e))) => {
            let why = e.to_string();
            let why = why.trim_end_matches(": {}");
            End::NoDevice(format!(
                "there is no graphics device that can draw it: {why}"
            ))
        }
        Ok(Err(e)) => End::Failed(e.to_string()),
        Err(panic) => resume_unwind(panic),
    }
}

/// A device of the processor's own.
fn software() -> WgpuSetup {
    let mut new = WgpuSetupCreateNew::without_display_handle();
    new.native_adapter_selector = Some(Arc::new(|adapters, surface| {
        let usable = |a: &&wgpu::Adapter| {
            a.get_info().device_type == wgpu::DeviceType::Cpu
                && surface.is_none_or(|s| a.is_surface_supported(s))
        };
        let found = adapters.iter().find(usable).cloned();
        found.ok_or_else(|| "there is no adapter that draws in software".to_owned())
    }));
    WgpuSetup::CreateNew(new)
}

/// Notes when the device is lost, and wakes the window.
fn watch(rs: &RenderState, lost: &Lost, ctx: &egui::Context) {
    let (lost, ctx) = (lost.clone(), ctx.clone());
    rs.device.set_device_lost_callback(move |reason, message| {
        let why = match reason {
            wgpu::DeviceLostReason::Destroyed => "it was destroyed".to_owned(),
            wgpu::DeviceLostReason::Unknown => message,
        };
        let _ = lost.set(why);
        ctx.request_repaint();
    });
}

/// The app in a window on one device.
struct Pane {
    kept: Rc<RefCell<Option<Kept>>>,
    settings: Option<Rc<Settings>>,
    lost: Lost,
    closed_by_loss: Rc<Cell<bool>>,
    /// Time of the window when this one was opened, s.
    begins_s: f64,
    /// When devices are lost on purpose, s.
    drill: Vec<f64>,
    shown: Shown,
}

/// How far a window has got.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shown {
    /// Nothing has been laid out.
    Nothing,
    /// The first frame has been laid out; it is painted before the next is.
    FirstFrame,
    /// The first frame has been painted.
    More,
}

impl Pane {
    /// Reports, once, that the first frame has been painted: the second follows it at once.
    fn tell_first_frame(&mut self, ctx: &egui::Context) {
        self.shown = match self.shown {
            Shown::Nothing => {
                ctx.request_repaint();
                Shown::FirstFrame
            }
            Shown::FirstFrame => {
                log::debug!("the first frame has been painted");
                Shown::More
            }
            Shown::More => return,
        };
    }

    /// Loses the device if that is due.
    fn drill(&self, frame: &eframe::Frame, before_s: f64, now_s: f64) {
        let due = |at: &f64| (before_s..now_s).contains(at);
        if self.drill.iter().any(due)
            && let Some(rs) = frame.wgpu_render_state()
        {
            rs.device.destroy();
            if let Err(e) = rs.device.poll(wgpu::PollType::wait_indefinitely()) {
                log::warn!("polling a device that was destroyed: {e}");
            }
        }
    }
}

impl eframe::App for Pane {
    /// A window that comes back goes on with the time of the one before.
    fn raw_input_hook(&mut self, _ctx: &egui::Context, raw: &mut egui::RawInput) {
        if let Some(time_s) = &mut raw.time {
            *time_s += self.begins_s;
        }
    }

    fn logic(&mut self, ctx: &egui::Context, _frame: &mut eframe::Frame) {
        // A window without its device closes; another opens.
        if self.lost.get().is_some() {
            return;
        }
        if let Some(kept) = &mut *self.kept.borrow_mut() {
            kept.app.logic(ctx);
        }
    }

    fn ui(&mut self, ui: &mut egui::Ui, frame: &mut eframe::Frame) {
        let kept = Rc::clone(&self.kept);
        let mut kept = kept.borrow_mut();
        let Some(kept) = &mut *kept else {
            return;
        };
        self.tell_first_frame(ui.ctx());
        let now_s = ui.input(|i| i.time);
        self.drill(frame, kept.time_s, now_s);
        kept.time_s = now_s;
        if self.lost.get().is_some() {
            // Nothing may be drawn any more.
            self.closed_by_loss.set(true);
            ui.send_viewport_cmd(egui::ViewportCommand::Close);
            return;
        }
        kept.app.frame(ui);
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        // What was kept the last time is on the disk long since.
        if let Some(settings) = &self.settings {
            settings.publish();
        }
        if let Some(kept) = &mut *self.kept.borrow_mut() {
            kept.app.save(storage);
        }
    }
}
