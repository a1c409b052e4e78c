//! What is wrong with a window's layout, by the rectangles of its widgets.

use std::collections::HashMap;

use egui::accesskit::{NodeId, Role};
use egui::epaint::{ClippedShape, Shape, TextShape};
use egui::{LayerId, Rect};
use egui_kittest::{Harness, kittest::NodeT};

/// Points by which rounding may move an edge.
const ROUNDING: f32 = 1.1;

/// Windows up to this width scroll their screens to the side, points.
const SCROLLED: f32 = 1000.0;

/// What an audit is told beside the window.
#[derive(Clone, Copy, Default)]
pub struct Audit {
    /// Title of the dialog that is open.
    pub title: Option<&'static str>,
    /// Whether the bar with STOP is there.
    pub shell: bool,
    /// Whether only what lies over the screen is looked at: the screen itself is a state of its own.
    pub over: bool,
    /// Whether only what stands around the screen is looked at.
    pub around: bool,
}

/// A widget as it lies in the window.
#[derive(Clone, Debug)]
pub struct Placed {
    node: NodeId,
    pub role: Role,
    pub name: String,
    /// All of it.
    pub rect: Rect,
    /// What panels and scroll areas leave of it.
    visible: Rect,
    layer: LayerId,
}

impl Placed {
    fn is_whole(&self, window: Rect) -> bool {
        let seen = self.visible.intersect(window).expand(ROUNDING);
        seen.contains_rect(self.rect)
    }

    pub fn is_control(&self) -> bool {
        matches!(
            self.role,
            Role::Button
                | Role::CheckBox
                | Role::RadioButton
                | Role::Slider
                | Role::SpinButton
                | Role::TextInput
                | Role::ComboBox
                | Role::Link
        )
    }

    fn is_shown(&self) -> bool {
        self.is_control()
            || matches!(
                self.role,
                Role::Label | Role::Meter | Role::Image | Role::Canvas | Role::ProgressIndicator
            )
    }

    pub fn told(&self) -> String {
        format!("{:?} “{}” {:?}", self.role, self.name, self.rect)
    }
}

/// Every widget that can be seen or used.
pub fn placed<S>(h: &Harness<'_, S>) -> Vec<Placed> {
    let rects: HashMap<NodeId, egui::WidgetRect> = h.ctx.viewport(|v| {
        let widgets = &v.prev_pass.widgets;
        let layers = widgets.layers();
        let all = layers.flat_map(|(_, of_layer)| of_layer.iter());
        all.map(|w| (w.id.accesskit_id(), *w)).collect()
    });
    let nodes = h.root().children_recursive();
    nodes
        .filter_map(|node| {
            let a = node.accesskit_node();
            let (id, _) = a.locate();
            let w = rects.get(&id)?;
            let one = Placed {
                node: id,
                role: a.role(),
                name: a.label().or_else(|| a.value()).unwrap_or_default(),
                rect: w.rect,
                visible: w.interact_rect,
                layer: w.layer_id,
            };
            (one.is_shown() && w.visible && w.rect.is_positive()).then_some(one)
        })
        .collect()
}

/// All that is wrong: one line each.
pub fn faults<S>(h: &mut Harness<'_, S>, audit: &Audit) -> Vec<String> {
    let window = h.ctx.content_rect();
    let mut found = Vec::new();
    let mut all = placed(h);
    overlaps(&all, &mut found);
    texts(h, &all, audit, &mut found);
    frames(h, audit, window, &mut found);
    if audit.shell {
        covered(h, &all, window, &mut found);
    }
    areas(h, window, &mut found);
    if audit.over {
        all.retain(|p| p.layer.order != egui::Order::Background);
    }
    if audit.around {
        let inside = Rect::from_min_max(
            window.min + egui::vec2(100.0, 92.0),
            window.max - egui::vec2(0.0, 30.0),
        );
        all.retain(|p| !inside.contains(p.rect.center()));
    }
    let cut: Vec<Placed> = all.into_iter().filter(|p| !p.is_whole(window)).collect();
    out_of_reach(h, cut, window, &mut found);
    found
}

/// Controls that lie on each other or on a text, within a layer.
fn overlaps(all: &[Placed], found: &mut Vec<String>) {
    for (i, a) in all.iter().enumerate() {
        for b in &all[..i] {
            let both = a.visible.intersect(b.visible);
            let apart = a.layer != b.layer || both.width() <= 2.0 || both.height() <= 2.0;
            let counts = match (a.is_control(), b.is_control()) {
                (true, true) => true,
                (true, false) | (false, true) => a.role == Role::Label || b.role == Role::Label,
                (false, false) => a.role == Role::Label && b.role == Role::Label,
            };
            if !apart && counts {
                found.push(format!("{} lies on {}", a.told(), b.told()));
            }
        }
    }
}

/// STOP and HOLD are whole, and nothing lies above them.
fn covered<S>(h: &Harness<'_, S>, all: &[Placed], window: Rect, found: &mut Vec<String>) {
    for name in ["■ STOP", "▮▮ HOLD", "▶ RESUME"] {
        let Some(button) = all.iter().find(|p| p.name == name) else {
            continue;
        };
        let inner = button.rect.shrink(2.0);
        let points = [
            inner.center(),
            inner.left_top(),
            inner.right_top(),
            inner.left_bottom(),
            inner.right_bottom(),
        ];
        let above = |p: &egui::Pos2| h.ctx.layer_id_at(*p).is_some_and(|l| l != button.layer);
        if !button.is_whole(window) || points.iter().any(above) {
            found.push(format!("{} is covered or cut", button.told()));
        }
    }
    if !all.iter().any(|p| p.name == "■ STOP") {
        found.push("there is no STOP".to_owned());
    }
}

/// Windows and menus lie within the window.
fn areas<S>(h: &Harness<'_, S>, window: Rect, found: &mut Vec<String>) {
    let layers: Vec<LayerId> = h
        .ctx
        .memory(|m| m.areas().visible_layer_ids().into_iter().collect());
    for layer in layers {
        let Some(rect) = h.ctx.memory(|m| m.area_rect(layer.id)) else {
            continue;
        };
        if !window.expand(ROUNDING).contains_rect(rect) {
            found.push(format!(
                "{} {rect:?} sticks out of the window",
                layer.short_debug_format()
            ));
        }
    }
}

/// A text as it is painted.
struct Painted<'a> {
    text: &'a TextShape,
    clip: Rect,
}

fn painted<'a>(shape: &'a Shape, clip: Rect, out: &mut Vec<Painted<'a>>) {
    match shape {
        Shape::Text(text) => out.push(Painted { text, clip }),
        Shape::Vec(shapes) => shapes.iter().for_each(|s| painted(s, clip, out)),
        _ => {}
    }
}

/// Numbers that are cut by an ellipsis, and texts that end at the edge of their panel.
fn texts<S>(h: &Harness<'_, S>, all: &[Placed], audit: &Audit, found: &mut Vec<String>) {
    let mut out = Vec::new();
    for ClippedShape {
        clip_rect, shape, ..
    } in &h.output().shapes
    {
        painted(shape, *clip_rect, &mut out);
    }
    if let Some(title) = audit.title {
        let whole = out.iter().any(|p| {
            p.text.galley.text() == title
                && !p.text.galley.elided
                && p.clip
                    .expand(ROUNDING)
                    .contains_rect(p.text.visual_bounding_rect())
        });
        if !whole {
            found.push(format!("the title “{title}” is cut"));
        }
    }
    for Painted { text, clip } in out {
        let galley = &text.galley;
        let rect = text.visual_bounding_rect();
        let said = galley.text();
        if galley.elided && !said.chars().any(char::is_alphabetic) {
            found.push(format!("the number “{said}” at {rect:?} is cut"));
        }
        let rows: Vec<(String, bool)> = galley
            .rows
            .iter()
            .map(|r| (r.text(), r.ends_with_newline))
            .collect();
        let broken = |pair: &[(String, bool)]| {
            let [(row, ends), (next, _)] = pair else {
                return false;
            };
            let within = row.chars().next_back().is_some_and(char::is_alphanumeric);
            !ends && within && next.chars().next().is_some_and(char::is_alphanumeric)
        };
        // Paths are one long word.
        if !said.contains('/') && rows.windows(2).any(broken) {
            found.push(format!("a word of “{said}” at {rect:?} is broken"));
        }
        // Of widgets what is cut is looked for by their rectangles: only what is painted by hand is left.
        let of_widget = |p: &Placed| {
            p.rect.expand(4.0).contains(rect.center())
                && !matches!(p.role, Role::Image | Role::Canvas)
        };
        let seen = rect.intersect(clip);
        let cut = seen.width() < rect.width() - 2.0 && seen.is_positive();
        // A window narrower than what screens need is scrolled to the side.
        let whole = !audit.shell || h.ctx.content_rect().width() > SCROLLED;
        if cut && whole && !all.iter().any(of_widget) {
            found.push(format!("the text “{said}” at {rect:?} ends at {clip:?}"));
        }
    }
}

/// What the window leaves free beside a screen, points.
const MARGIN: f32 = 6.0;

/// How far from the window's right edge a screen is cut at most, points: what lies within a panel is cut farther inside.
const EDGE: f32 = 9.0;

/// Frames of panels that end beyond the window's right edge, where screens are not scrolled to the side.
fn frames<S>(h: &Harness<'_, S>, audit: &Audit, window: Rect, found: &mut Vec<String>) {
    if audit.shell && window.width() <= SCROLLED {
        return;
    }
    let margin = if audit.shell { MARGIN } else { 0.0 };
    for ClippedShape {
        clip_rect: clip,
        shape,
        ..
    } in &h.output().shapes
    {
        let mut rects = Vec::new();
        framed(shape, &mut rects);
        for rect in rects {
            let of_screen = clip.right() >= window.right() - EDGE;
            let seen = rect.intersect(*clip).is_positive();
            let right = clip.right().min(window.right() - margin);
            if of_screen && seen && rect.right() > right + ROUNDING {
                found.push(format!("a frame {rect:?} ends beyond the window's edge"));
            }
        }
    }
}

fn framed(shape: &Shape, out: &mut Vec<Rect>) {
    match shape {
        Shape::Rect(r) if r.stroke.width > 0.0 => out.push(r.rect),
        Shape::Vec(shapes) => shapes.iter().for_each(|s| framed(s, out)),
        _ => {}
    }
}

/// What no scrolling brings into view.
fn out_of_reach<S>(
    h: &mut Harness<'_, S>,
    mut cut: Vec<Placed>,
    window: Rect,
    found: &mut Vec<String>,
) {
    h.ctx
        .all_styles_mut(|s| s.scroll_animation = egui::style::ScrollAnimation::none());
    while let Some(first) = cut.pop() {
        let mut seen = Vec::new();
        let mut parts = Rect::NOTHING;
        scroll_to(h, &first);
        for corner in [
            None,
            Some([-1.0, -1.0]),
            Some([1.0, 1.0]),
            Some([-1.0, 1.0]),
            Some([1.0, -1.0]),
        ] {
            // A scroll area within a scroll area: the outer one is taken to a corner first.
            if let Some(corner) = corner {
                turn_wheel(h, &first, window, corner);
                parts = parts.union(part(&placed(h), &first, window));
                scroll_to(h, &first);
            }
            let now = placed(h);
            // What is larger than its scroll area is seen piece by piece.
            parts = parts.union(part(&now, &first, window));
            let all = Rect::from_min_size(egui::Pos2::ZERO, first.rect.size());
            if parts.expand(ROUNDING).contains_rect(all) {
                seen.push(first.node);
            }
            seen.extend(
                now.into_iter()
                    .filter(|n| n.is_whole(window))
                    .map(|n| n.node),
            );
            if seen.contains(&first.node) {
                break;
            }
        }
        if !seen.contains(&first.node) {
            let now = placed(h);
            let now = now.iter().find(|n| n.node == first.node);
            let visible = now.map(|n| n.visible.intersect(window));
            found.push(format!(
                "{} is out of reach: of it {visible:?} is seen",
                first.told()
            ));
        }
        cut.retain(|p| !seen.contains(&p.node));
    }
}

/// Which part of a widget is seen now, from its own upper left corner.
fn part(now: &[Placed], of: &Placed, window: Rect) -> Rect {
    let Some(now) = now.iter().find(|n| n.node == of.node) else {
        return Rect::NOTHING;
    };
    let seen = now.visible.intersect(window);
    match seen.is_positive() {
        true => seen.translate(-now.rect.min.to_vec2()),
        false => Rect::NOTHING,
    }
}

fn scroll_to<S>(h: &mut Harness<'_, S>, to: &Placed) {
    let node = h
        .root()
        .children_recursive()
        .find(|n| n.accesskit_node().locate().0 == to.node);
    if let Some(node) = node {
        node.scroll_to_me();
    }
    h.run_steps(4);
}

/// Turns the wheel as far as it goes, over the place nearest to a widget.
fn turn_wheel<S>(h: &mut Harness<'_, S>, near: &Placed, window: Rect, corner: [f32; 2]) {
    let at = near.rect.center().clamp(
        window.min + egui::vec2(150.0, 110.0),
        window.max - egui::vec2(20.0, 50.0),
    );
    h.hover_at(at);
    h.run_steps(1);
    for _ in 0..2 {
        h.event(egui::Event::MouseWheel {
            unit: egui::MouseWheelUnit::Point,
            delta: egui::vec2(-corner[0] * 4000.0, -corner[1] * 4000.0),
            phase: egui::TouchPhase::Move,
            source: egui::MouseWheelSource::Wheel,
            modifiers: egui::Modifiers::NONE,
        });
        h.run_steps(3);
    }
    h.remove_cursor();
    h.run_steps(4);
}
