//! IMUs, boards, and how far the signals are from the training data.

use egui::{RichText, Ui};

use super::state::{Reading, axes, channel_age_s, imu_channel};
use crate::analysis::history::{Channel, imu_residual_deg};
use crate::gui::panels::plot::{Dash, swatch};
use crate::gui::panels::widgets::{
    NIS_WIDTH, age, cell, cell_left, dense, fault_probability, heading, health, imu_name,
    imu_sentence, nis_level, nis_meter, nis_words, note, number, status,
};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::{BOARDS, FAR_DISTANCE, IMUS, SPRINGS, SensorFrame, UNKNOWN_RAD};

/// Parts of frames are counted over this, s.
const COUNTED_S: f64 = 10.0;

/// The card; its columns are `scale` times as wide as usual.
pub fn ui(ui: &mut Ui, view: &View<'_>, frame: &SensorFrame, reading: Reading, scale: f32) {
    imus(ui, view, frame, reading, scale);
    ui.add_space(4.0 * scale);
    boards(ui, view, scale);
    let link = &view.snapshot.link;
    heading(
        ui,
        &format!(
            "{} frames, {} lost, {} late or duplicate (all boards), newest {} old",
            link.frames,
            link.frames_lost,
            link.frames_late,
            age(link.age_s)
        ),
    );
    let Some(estimate) = &view.snapshot.estimate else {
        return;
    };
    let d = estimate.training_distance;
    let bound = number(FAR_DISTANCE, 1);
    let text = format!("Distance from the training data {}", number(d, 2));
    if d > FAR_DISTANCE {
        status(ui, Level::Warning, &format!("{text}: far, above {bound}"))
    } else {
        note(ui, format!("{text}: within {bound}"))
    }
    .on_hover_text(
        "Distance of the 24 sensor signals from the training data in standard deviations: about 1 inside",
    );
}

fn values(view: &View<'_>, frame: &SensorFrame, reading: Reading, i: usize) -> [f64; 3] {
    let none = [f64::NAN; 3];
    match reading {
        Reading::Calibrated => frame.sensors.imu_ypr_rad[i].map(f64::to_degrees),
        Reading::Raw => {
            let raw = view.snapshot.raw.as_ref().filter(|r| r.has_imu(i));
            raw.map_or(none, |r| r.imu[i].gyro_rad_s.map(f64::to_degrees))
        }
        Reading::Residual => imu_residual_deg(view.snapshot, i),
    }
}

fn imus(ui: &mut Ui, view: &View<'_>, frame: &SensorFrame, reading: Reading, scale: f32) {
    let p = *Palette::in_ui(ui);
    dense(ui);
    ui.spacing_mut().interact_size.y *= scale;
    let [name_width, band_width, age_width, health_width] =
        [82.0, 40.0, 36.0, 66.0].map(|w| w * scale);
    // In large type there is space for the figure beside the narrow bar.
    let nis_width = if scale > 1.0 { 44.0 } else { 0.0 };
    let fixed =
        name_width + NIS_WIDTH + nis_width + band_width + age_width + health_width + 8.0 * 4.0;
    let width = ((ui.available_width() - fixed) / 3.0).max(40.0);
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    ui.horizontal(|ui| {
        let unit = imu_channel(reading, 0, 0).unit();
        cell_left(ui, name_width, head(&format!("IMUs / {unit}")));
        for name in axes(reading) {
            cell(ui, width, head(name));
        }
        ui.add_space(NIS_WIDTH + 4.0);
        if nis_width > 0.0 {
            cell(ui, nis_width, head("NIS"))
                .on_hover_text("Normalised innovation squared: 1 for noise alone");
        }
        cell(ui, band_width, head("± deg"))
            .on_hover_text("Band: standard deviation beyond the usual noise");
        cell(ui, age_width, head("age"));
        cell(ui, health_width, head("health"));
    });
    for i in 0..IMUS {
        let condition = frame.health.imus[i];
        let (glyph, word, level) = health(condition);
        ui.horizontal(|ui| {
            swatch(ui, p.signal(Channel::Imu(i, 0)), Dash::Solid);
            cell_left(
                ui,
                name_width - 20.0,
                RichText::new(imu_name(i)).color(p.weak),
            );
            for v in values(view, frame, reading, i) {
                cell(ui, width, RichText::new(number(v, 2)));
            }
            nis_meter(
                ui,
                &format!("IMU {} NIS", i + 1),
                frame.quality.nis[SPRINGS + i],
            );
            if nis_width > 0.0 {
                let nis = frame.quality.nis[SPRINGS + i];
                let color = p.level(nis_level(nis));
                let text = RichText::new(number(nis, 1)).small().color(color);
                cell(ui, nis_width, text).on_hover_text(nis_words(nis));
            }
            let evidence = frame.imu_evidence(i);
            let band_deg = evidence.extra_sigma.to_degrees();
            let color = match evidence.extra_sigma {
                sd if sd >= UNKNOWN_RAD => p.critical,
                _ => p.level(level),
            };
            cell(
                ui,
                band_width,
                RichText::new(number(band_deg, 2)).small().color(color),
            )
            .on_hover_text("Largest of its three angles; the heading follows from the springs");
            let delivered = view.snapshot.raw.as_ref().is_some_and(|r| r.has_imu(i));
            let old = channel_age_s(view, delivered, i / 2, Channel::Imu(i, 0));
            let old = old.map_or("—".into(), age);
            cell(ui, age_width, RichText::new(old).small().color(p.weak))
                .on_hover_text("Age of the newest reading");
            let mut hover = imu_sentence(frame, i);
            if band_deg > 0.0 {
                hover = format!(
                    "{hover}\nMay be off by ± {} deg beyond its usual noise.",
                    number(band_deg, 2)
                );
            }
            let text = match fault_probability(&evidence) {
                Some((probability, level)) => {
                    RichText::new(format!("{glyph} {probability}")).color(p.level(level))
                }
                None => RichText::new(format!("{glyph} {word}")).color(p.level(level)),
            };
            cell(ui, health_width, text).on_hover_text(hover);
        });
    }
}

// Frames within the last seconds in which a board's springs came.
fn parts(view: &View<'_>, board: usize) -> usize {
    let own = SPRINGS / BOARDS;
    (board * own..(board + 1) * own)
        .map(|i| {
            let from = view.now_s - COUNTED_S;
            let signals = view.signals([from, view.now_s]);
            let all = signals.points(Channel::SpringRaw(i), from, view.now_s);
            all.count()
        })
        .max()
        .unwrap_or(0)
}

fn boards(ui: &mut Ui, view: &View<'_>, scale: f32) {
    let p = *Palette::in_ui(ui);
    let link = &view.snapshot.link;
    let columns = [76.0, 66.0, 58.0, 62.0, 76.0].map(|w| w * scale);
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    ui.horizontal(|ui| {
        cell_left(ui, columns[0], head("Boards"));
        for (t, w) in ["rate", "age", "dropped", "clock"]
            .into_iter()
            .zip(&columns[1..])
        {
            cell(ui, *w, head(t));
        }
    });
    let counts = [0, 1].map(|b| parts(view, b));
    let most = counts.iter().copied().max().unwrap_or(0);
    for (i, count) in counts.into_iter().enumerate() {
        let late = view.snapshot.raw.as_ref().map(|r| r.board_age_s[i]);
        ui.horizontal(|ui| {
            let name = RichText::new(format!("Segment {}", i + 1)).color(p.weak);
            cell_left(ui, columns[0], name);
            let rate = number(link.board_rate_hz[i], 1);
            cell(ui, columns[1], format!("{rate} Hz"))
                .on_hover_text("Frames per second over the last second");
            let text = late.map_or("—".into(), |a| format!("{} ms", number(a * 1e3, 1)));
            cell(ui, columns[2], text).on_hover_text("Age of the board's part of the newest frame");
            let dropped = if most > 0 {
                (most - count).to_string()
            } else {
                "—".into()
            };
            cell(ui, columns[3], dropped).on_hover_text(
                "Frames of the last 10 s in which this board's springs were missing while the other's came",
            );
            clock(ui, view, i, columns[4]);
        });
    }
}

fn clock(ui: &mut Ui, view: &View<'_>, i: usize, width: f32) {
    let clock = view.snapshot.link.board_clock[i];
    let offset = clock.map_or("—".into(), |c| format!("{} s", number(c.offset_s, 2)));
    cell(ui, width, offset).on_hover_text(clock.map_or(
        "The board's clock has not been fitted yet".to_owned(),
        |c| {
            format!(
                "Session time minus board time. The board's clock runs {} ppm {}; pings agree \
                 within {} ms, a round trip takes {} ms",
                number(c.skew_ratio.abs() * 1e6, 0),
                if c.skew_ratio > 0.0 { "slow" } else { "fast" },
                number(c.residual_s * 1e3, 3),
                number(c.round_trip_s * 1e3, 2)
            )
        },
    ));
}
