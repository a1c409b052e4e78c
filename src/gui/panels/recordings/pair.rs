//! Recordings A and B: which is played, how they lie on each other in time, what is drawn of both.

use crate::analysis::compare::{Samples, Wrap, difference};
use crate::analysis::history::{Channel, POSE_NAMES};
use crate::analysis::pairing::{Alignment, Pairing, samples};
use crate::analysis::player::Player;
use crate::gui::panels::plot::{Dash, Drawn};
use crate::gui::panels::widgets::{imu_name, number};
use crate::gui::services::{Pending, Services};
use crate::signal::{CHAMBERS, IMUS, SPRINGS, spring_name};

/// One of two recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Side {
    /// The one that is played first.
    #[default]
    A,
    /// The one it is compared with.
    B,
}

impl Side {
    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }

    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// What the plots show of two recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compared {
    /// The one that is played.
    #[default]
    One,
    /// Both in one plot.
    Both,
    /// A less B.
    Difference,
}

/// What the plots show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quantity {
    /// x, y, z of the tip.
    #[default]
    Position,
    /// Yaw, pitch, roll of the tip.
    Orientation,
    /// Pressures of the chambers.
    Pressure,
    /// Lengths of the springs.
    Springs,
    /// Angles of the IMUs.
    Imus,
}

/// A plot: title, its signals with their names, least span of its axis.
pub type Row = (String, Vec<(Channel, String)>, f64);

impl Quantity {
    /// All there are.
    pub const ALL: [Self; 5] = [
        Self::Position,
        Self::Orientation,
        Self::Pressure,
        Self::Springs,
        Self::Imus,
    ];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "Tip position",
            Self::Orientation => "Tip orientation",
            Self::Pressure => "Pressures",
            Self::Springs => "Springs",
            Self::Imus => "IMUs",
        }
    }

    /// The plots.
    pub fn rows(self) -> Vec<Row> {
        let pose = |i: usize| {
            let title = format!("{} / {}", POSE_NAMES[i], Channel::Tip(i).unit());
            (title, vec![(Channel::Tip(i), String::new())], 1.0)
        };
        match self {
            Self::Position => (0..3).map(pose).collect(),
            Self::Orientation => (3..6).map(pose).collect(),
            Self::Pressure => (0..2)
                .map(|s| {
                    let own = 3 * s..3 * s + CHAMBERS / 2;
                    let signals = own.map(|i| (Channel::ChamberMeasured(i), (i + 1).to_string()));
                    let title = format!("Chambers of segment {} / kPa", s + 1);
                    (title, signals.collect(), 1.0)
                })
                .collect(),
            Self::Springs => (0..2)
                .map(|s| {
                    let own = 6 * s..6 * s + SPRINGS / 2;
                    let signals = own.map(|i| (Channel::Spring(i), spring_name(i)));
                    let title = format!("Springs of segment {} / mm", s + 1);
                    (title, signals.collect(), 1.0)
                })
                .collect(),
            Self::Imus => (0..3)
                .map(|k| {
                    let signals = (0..IMUS).map(|i| (Channel::Imu(i, k), imu_name(i)));
                    (
                        format!("IMU {} / deg", POSE_NAMES[3 + k]),
                        signals.collect(),
                        1.0,
                    )
                })
                .collect(),
        }
    }
}

/// Two recordings, of which one is played; that one is the window's player.
#[derive(Default)]
pub struct Pair {
    /// Which one is played.
    pub played: Side,
    /// The other one.
    pub other: Option<Player>,
    /// What the plots show of both.
    pub compared: Compared,
    /// What the plots show.
    pub quantity: Quantity,
    /// Time of A minus time of B at the same moment, s, each since its recording began.
    pub offset_s: f64,
    /// Result of the automatic alignment.
    pub alignment: Option<Alignment>,
    aligning: Pending<Alignment>,
    cache: Option<(Key, Vec<Plotted>)>,
}

#[derive(Clone, Debug, PartialEq)]
struct Key {
    quantity: Quantity,
    compared: Compared,
    offset_s: f64,
    names: [String; 2],
    rows: [usize; 2],
}

/// A plot of both recordings.
#[derive(Clone, Debug)]
pub struct Plotted {
    /// Its title, with figures of the difference where that is shown.
    pub title: String,
    /// Its lines on the time base of A.
    pub lines: Vec<Drawn>,
    /// Least span of its axis.
    pub min_span: f64,
}

impl Pair {
    /// Puts a recording into its place: beside the other one, if it is to be compared, else it is played alone.
    pub fn place(
        &mut self,
        (side, compared): (Side, bool),
        mut new: Player,
        player: &mut Option<Player>,
        services: &mut Services,
    ) {
        if player.is_none() || side == self.played {
            if player.is_none() && side != self.played {
                self.played = side;
                self.other = None;
            }
            *player = Some(new);
            self.compared = match compared && self.other.is_some() {
                true => Compared::Both,
                false => Compared::One,
            };
        } else {
            new.playing = false;
            self.other = Some(new);
            self.compared = Compared::Both;
        }
        self.align(player, services);
    }

    /// A and B, as far as they are there.
    pub fn sides<'a>(&'a self, player: Option<&'a Player>) -> [Option<&'a Player>; 2] {
        match self.played {
            Side::A => [player, self.other.as_ref()],
            Side::B => [self.other.as_ref(), player],
        }
    }

    /// Has found how B lies on A.
    pub fn align(&mut self, player: &Option<Player>, services: &mut Services) {
        self.forget_alignment();
        self.offset_s = 0.0;
        let [Some(a), Some(b)] = self.sides(player.as_ref()) else {
            return;
        };
        self.aligning.begin((services.align)(Pairing::of([a, b])));
        self.poll();
    }

    /// Discards the alignment, also one in progress.
    pub fn forget_alignment(&mut self) {
        self.alignment = None;
        self.aligning.cancel();
    }

    /// Whether it is being found how they lie on each other.
    pub fn busy(&self) -> bool {
        self.aligning.is_busy()
    }

    /// Takes how they lie on each other, when it was found.
    pub fn poll(&mut self) {
        let Some(answer) = self.aligning.take() else {
            return;
        };
        self.alignment = answer.ok();
        if let Some(Ok(shift)) = self.alignment.as_ref().map(|a| &a.found) {
            // Milliseconds are enough and fit the field.
            self.offset_s = (shift.offset_s * 1e3).round() * 1e-3;
        }
    }

    /// Plays the other one from the same moment.
    pub fn swap(&mut self, player: &mut Option<Player>) {
        let (Some(now), Some(next)) = (player.as_mut(), self.other.as_mut()) else {
            return;
        };
        let shift = match self.played {
            Side::A => -self.offset_s,
            Side::B => self.offset_s,
        };
        next.position_s = (now.position_s + shift).clamp(0.0, next.duration_s());
        next.playing = now.playing;
        next.speed = now.speed;
        next.at_end = now.at_end;
        now.playing = false;
        std::mem::swap(now, next);
        self.played = self.played.other();
    }

    /// The plots of both recordings, on the time base of A.
    pub fn plots(&mut self, player: &Player) -> &[Plotted] {
        let [Some(a), Some(b)] = self.sides(Some(player)) else {
            return &[];
        };
        let key = Key {
            quantity: self.quantity,
            compared: self.compared,
            offset_s: self.offset_s,
            names: [a, b].map(|p| p.trace().name.clone()),
            rows: [a, b].map(|p| p.history().len()),
        };
        if self.cache.as_ref().is_none_or(|(of, _)| *of != key) {
            let plots = key.quantity.rows().into_iter();
            let plots = plots.map(|row| plotted(row, a, b, &key)).collect();
            self.cache = Some((key, plots));
        }
        self.cache.as_ref().map_or(&[], |(_, plots)| plots)
    }
}

fn plotted((title, signals, min_span): Row, a: &Player, b: &Player, key: &Key) -> Plotted {
    let start_s = a.start_s();
    let offset_s = key.offset_s;
    let move_by = |s: Samples, dt: f64| -> Samples {
        s.into_iter().map(|[t, v]| [t + start_s + dt, v]).collect()
    };
    let of = |p: &Player, channel| samples(p.history(), p.start_s(), channel);
    if key.compared == Compared::Difference {
        let mut all = Vec::new();
        let lines = signals.into_iter().map(|(channel, name)| {
            let wrap = match channel.unit() {
                "deg" => Wrap::Turn,
                _ => Wrap::None,
            };
            let d = difference(&of(a, channel), &of(b, channel), offset_s, wrap);
            all.extend(d.iter().map(|q| q[1]));
            Drawn::new(name, channel, Dash::Solid, move_by(d, 0.0))
        });
        let lines: Vec<Drawn> = lines.collect();
        let title = format!("{title}, A − B: {}", figures(&all));
        return Plotted {
            title,
            lines,
            min_span: 0.5 * min_span,
        };
    }
    let mut lines = Vec::new();
    for (channel, name) in signals {
        for (player, side, dt, dash) in
            [(a, "A", 0.0, Dash::Solid), (b, "B", offset_s, Dash::Dashed)]
        {
            // One name for the two lines of a signal, where there are several signals.
            let name = match (name.is_empty(), side) {
                (true, _) => side.to_owned(),
                (false, "A") => name.clone(),
                (false, _) => String::new(),
            };
            let points = move_by(of(player, channel), dt);
            lines.push(Drawn::new(name, channel, dash, points));
        }
    }
    Plotted {
        title,
        lines,
        min_span,
    }
}

fn figures(d: &[f64]) -> String {
    if d.is_empty() {
        return "nothing in common".into();
    }
    let n = d.len() as f64;
    let mean = d.iter().sum::<f64>() / n;
    let rms = (d.iter().map(|x| x * x).sum::<f64>() / n).sqrt();
    let largest = d.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    format!(
        "mean {}, RMS {}, largest {}",
        number(mean, 2),
        number(rms, 2),
        number(largest, 2)
    )
}
