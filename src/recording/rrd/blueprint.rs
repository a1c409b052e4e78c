//! The layout a viewer opens a recording with.

use rerun::blueprint::{
    Blueprint, Horizontal, Spatial3DView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};

use super::schema::TIMELINE;

/// The arm in 3D with the log below it; springs, pressures and errors beside it.
pub(super) fn blueprint() -> Blueprint {
    let plot = |name: &str, contents: &[&str]| {
        TimeSeriesView::new(name)
            .with_origin("/")
            .with_contents(contents.iter().copied())
            .into()
    };
    let arm = Spatial3DView::new("Arm")
        .with_origin("/")
        .with_contents(["+ /arm/**", "+ /tip/**", "+ /goal/**"])
        .into();
    let log = TextLogView::new("Log")
        .with_origin("/")
        .with_contents(["+ /mode", "+ /events", "+ /alarms"])
        .into();
    let left = Vertical::new([arm, log]).with_row_shares([4.0, 1.0]).into();
    let right = Vertical::new([
        plot("Springs, mm", &["+ /sensors/spring_mm"]),
        plot(
            "Pressures, kPa",
            &["+ /chambers/pressure_kpa", "+ /chambers/set_kpa"],
        ),
        plot(
            "Tip, mm",
            &[
                "+ /tip/predicted/position_mm",
                "+ /tip/vicon/position_mm",
                "+ /goal/position_mm",
            ],
        ),
        plot("Error, mm", &["+ /tip/error_mm"]),
    ])
    .into();
    Blueprint::new(Horizontal::new([left, right]).with_column_shares([1.0, 1.0]))
        .with_auto_views(false)
        .with_auto_layout(false)
        .with_time_panel(TimePanel::new().with_timeline(TIMELINE))
}
