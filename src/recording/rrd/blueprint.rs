//! The layout a viewer opens a recording with.

use std::sync::OnceLock;

use rerun::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial3DView,
    TextLogView, TimePanel, TimeSeriesView, Vertical,
};
use rerun::external::re_sdk_types::blueprint::archetypes::{
    EyeControls3D, PlotLegend, TimeAxis, VisibleTimeRanges,
};
use rerun::external::re_sdk_types::blueprint::components::{
    Corner2D, LinkAxis, PanelState, PlayState, VisibleTimeRange,
};
use rerun::external::re_sdk_types::datatypes;
use rerun::log::{Chunk, LogMsg, RowId};
use rerun::{
    AsComponents, EntityPath, RecordingStreamBuilder, SerializedComponentBatch, StoreKind,
    TimePoint,
};

use super::error::BatchError;
use super::schema::{self, TIMELINE};

/// What a viewer is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shown {
    /// A recording that is whole.
    File,
    /// A twin that runs.
    Live,
}

/// Time that the plots of a running twin show, ns.
const LIVE_NS: i64 = 30_000_000_000;
/// Where the eye is and what it looks at, m: the whole arm, from the front and a little above.
const EYE_M: [f32; 3] = [0.66, -0.60, 0.0];
const LOOK_M: [f32; 3] = [0.0, 0.0, -0.19];

/// The messages that send a viewer the layout. They are the same for every recording, and made once: the library's
/// maker of layouts leaves two threads behind each time.
pub(super) fn layout(shown: Shown) -> Result<Vec<LogMsg>, BatchError> {
    static MADE: [OnceLock<Vec<LogMsg>>; 2] = [const { OnceLock::new() }; 2];
    let made = &MADE[match shown {
        Shown::File => 0,
        Shown::Live => 1,
    }];
    if let Some(messages) = made.get() {
        return Ok(messages.clone());
    }
    let messages = Layout::new(shown).messages()?;
    Ok(made.get_or_init(|| messages).clone())
}

/// A layout, and properties of its views that the layout's builder does not offer.
struct Layout {
    blueprint: Blueprint,
    properties: Vec<(EntityPath, Vec<SerializedComponentBatch>)>,
}

impl Layout {
    /// The arm in 3D with the log below it; springs, pressures, tip and error beside it.
    fn new(shown: Shown) -> Self {
        let mut properties = Vec::new();
        let arm = Spatial3DView::new("Arm")
            .with_origin("/")
            .with_contents(["+ /arm/**", "+ /tip/**", "+ /goal/**"])
            .into();
        let eye = EyeControls3D::new()
            .with_position(EYE_M)
            .with_look_target(LOOK_M)
            .with_eye_up([0.0, 0.0, 1.0]);
        set(&mut properties, &arm, "EyeControls3D", &eye);
        let log = TextLogView::new("Log")
            .with_origin("/")
            .with_contents(["+ /mode", "+ /events", "+ /alarms", "+ /marks"])
            .into();
        let left = Vertical::new([arm, log]).with_row_shares([4.0, 1.0]).into();
        let mut plot = |name: &str, contents: &[&str], legend: bool| {
            let view = TimeSeriesView::new(name)
                .with_origin("/")
                .with_contents(contents.iter().copied())
                .into();
            // Twelve names would hide the curves; pointing at a curve shows its name.
            let legend = PlotLegend::new()
                .with_visible(legend)
                .with_corner(Corner2D::LeftTop);
            set(&mut properties, &view, "PlotLegend", &legend);
            let axis = TimeAxis::new().with_link(LinkAxis::LinkToGlobal);
            set(&mut properties, &view, "TimeAxis", &axis);
            if shown == Shown::Live {
                let ranges = VisibleTimeRanges::new([last(LIVE_NS)]);
                set(&mut properties, &view, "VisibleTimeRanges", &ranges);
            }
            view
        };
        let right = Vertical::new([
            plot("Springs, mm", &["+ /sensors/spring_mm"], false),
            plot(
                "Pressures measured and set, kPa",
                &["+ /chambers/pressure_kpa", "+ /chambers/set_kpa"],
                true,
            ),
            plot(
                "Tip x, y, z: predicted, motion capture, goal, mm",
                &[
                    "+ /tip/predicted/position_mm",
                    "+ /tip/vicon/position_mm",
                    "+ /goal/position_mm",
                ],
                true,
            ),
            plot(
                "Predicted against motion capture, mm",
                &["+ /tip/error_mm"],
                false,
            ),
        ])
        .into();
        let mut time = TimePanel::new()
            .with_timeline(TIMELINE)
            .with_state(PanelState::Collapsed);
        if shown == Shown::Live {
            time = time.with_play_state(PlayState::Following);
        }
        let root = Horizontal::new([left, right]).with_column_shares([1.0, 1.0]);
        let blueprint = Blueprint::new(root)
            .with_auto_views(false)
            .with_auto_layout(false)
            .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
            .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
            .with_time_panel(time);
        Self {
            blueprint,
            properties,
        }
    }

    fn messages(&self) -> Result<Vec<LogMsg>, BatchError> {
        let (stream, storage) = RecordingStreamBuilder::new(schema::APPLICATION)
            .enabled(true)
            .memory()?;
        self.blueprint.send(&stream, Default::default())?;
        let mut messages = storage.take();
        stream.disconnect();
        // Messages about the stream itself are not part of the layout.
        messages.retain(|m| m.store_id().kind() == StoreKind::Blueprint);
        self.complete(&mut messages)?;
        Ok(messages)
    }

    /// Puts the properties of the views among the messages of the layout, before it is shown.
    fn complete(&self, messages: &mut Vec<LogMsg>) -> Result<(), BatchError> {
        let shown = messages.iter().enumerate().find_map(|(i, m)| match m {
            LogMsg::BlueprintActivationCommand(command) => Some((i, command.blueprint_id.clone())),
            _ => None,
        });
        let Some((at, store)) = shown else {
            return Ok(());
        };
        let mut more = Vec::with_capacity(self.properties.len());
        for (path, batches) in &self.properties {
            let chunk = Chunk::builder(path.clone())
                .with_serialized_batches(RowId::new(), TimePoint::default(), batches.clone())
                .build()?;
            more.push(LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg()?));
        }
        messages.splice(at..at, more);
        Ok(())
    }
}

fn set(
    properties: &mut Vec<(EntityPath, Vec<SerializedComponentBatch>)>,
    view: &ContainerLike,
    name: &str,
    property: &dyn AsComponents,
) {
    if let ContainerLike::View(view) = view {
        let path = format!("{}/{name}", view.blueprint_path());
        properties.push((path.into(), property.as_serialized_batches()));
    }
}

/// The time up to the cursor.
fn last(span_ns: i64) -> VisibleTimeRange {
    VisibleTimeRange(datatypes::VisibleTimeRange {
        timeline: TIMELINE.into(),
        range: datatypes::TimeRange {
            start: datatypes::TimeRangeBoundary::CursorRelative((-span_ns).into()),
            end: datatypes::TimeRangeBoundary::AT_CURSOR,
        },
    })
}
