//! One controller board as its firmware behaves, without I/O: bytes and readings in, bytes and
//! set pressures out.
//!
//! The board speaks [`crate::link::wire`] and keeps the arm safe on its own. SAFE means pumps off,
//! latched until a RESET with a new id. It holds from the start, and is entered when
//!
//! - ESTOP arrives,
//! - heartbeats stop for the configured time (200 ms) after having begun,
//! - a set point is not renewed within its time-to-live,
//! - the emergency stop's contact is open,
//! - a chamber is beyond ±42 kPa, or its gauge gives no value, in two checks running (a check every
//!   5 ms, so within 20 ms).
//!
//! Set pressures are clamped to ±40 kPa and followed only while they are fresh, heartbeats come,
//! and a CONFIG has been accepted since boot. They begin at the measured pressures and move by 15 kPa/s at most.
//! `tests/it/conformance.rs` holds this board and the firmware to
//! the same cases.

use super::clock::Clock;
use crate::link::wire::{
    ALL_BOARDS, Body, Config, Decoder, Hello, LONGEST_TTL_MS, PRELOAD_S, Packet, Received,
    SAMPLE_RATE_HZ, SCHEMA_HASH, SLEW_PA_S, Sample, Setpoint, VENT_PA_S, VENTED_PA, VERSION,
    encode, fault, flag, imu_codes, pressure_code, pressure_pa,
};
use crate::signal::{CHAMBERS, Gripper, IMUS, ImuRaw, SPRINGS};

/// Springs of one board.
const SPRINGS_EACH: usize = SPRINGS / 2;
/// IMUs of one board.
const IMUS_EACH: usize = IMUS / 2;
/// Chambers of one board.
pub const CHAMBERS_EACH: usize = CHAMBERS / 2;
/// Time between two checks of the gauges, s.
const CHECK_PERIOD_S: f64 = 0.005;
/// Checks running that must agree before the pumps go off.
const CHECKS_TO_TRIP: u8 = 2;
/// The emergency stop is looked at, and set pressures are moved, this often, s.
const STEP_S: f64 = 0.004;
/// Slack of the schedule, s: a caller's time steps need not hit it to the last bit.
const SLACK_S: f64 = 1e-6;
/// A chamber that is vented may show so much more than at the beginning, Pa.
const VENT_SLACK_PA: f64 = 1e3;
/// Name of this firmware in HELLO: "RIG1".
pub const FIRMWARE_ID: u32 = u32::from_be_bytes(*b"RIG1");

/// One spring's reciprocal count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpringReading {
    /// Whole oscillator periods within the gate.
    pub count: u32,
    /// Length of the gate, board clock ticks.
    pub gate_ticks: u32,
}

/// Readings of one board's sensors at an instant; `None` where a sensor does not answer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Readings {
    /// The board's six springs.
    pub springs: [Option<SpringReading>; SPRINGS_EACH],
    /// The board's two IMUs, SI units in their own axes.
    pub imus: [Option<ImuRaw>; IMUS_EACH],
    /// Gauge pressure of the board's three chambers, Pa.
    pub chamber_pa: [Option<f64>; CHAMBERS_EACH],
    /// Whether the emergency stop's contact is open.
    pub stop_open: bool,
}

/// Properties in which boards differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardSetup {
    /// 0-based: board 0 serves segment 1, board 1 segment 2.
    pub id: u8,
    /// Differs from one boot to the next.
    pub boot_nonce: u32,
    /// Nominal clock rate, ticks/s.
    pub tick_rate_hz: u32,
    /// How fast the clock runs.
    pub clock: Clock,
    /// Reading of the clock at t = 0, s (any value: it wraps).
    pub clock_offset_s: f64,
    /// Number of the arm in the board's EEPROM.
    pub rig: u32,
}

/// An emulated board. All times `t_s` are the rig's true time in s and must not decrease.
#[derive(Clone, Debug)]
pub struct Board {
    setup: BoardSetup,
    decoder: Decoder,
    out: Vec<u8>,
    seq: u16,
    config: Option<Config>,
    heartbeat_s: Option<f64>,
    drive: Option<Drive>,
    /// Set pressures, Pa: where they are, or where they were when the pumps went off.
    set_pa: [f64; CHAMBERS_EACH],
    /// What the gauges showed last, Pa; a chamber without a gauge counts as where it was set last.
    gauge_pa: [f64; CHAMBERS_EACH],
    supply_cut: bool,
    /// Pressures beyond which chambers that are vented are stopped, Pa.
    vent_limit_pa: [f64; CHAMBERS_EACH],
    stop_open: bool,
    stop_checks: u8,
    next_step_s: f64,
    latched: u16,
    last_reset: Option<u32>,
    gauge_checks: u8,
    channel_faults: u16,
    gripper: Gripper,
    /// Whether the gripper has had a command since the power came.
    gripper_known: bool,
    next_check_s: f64,
    next_sample_ticks: f64,
}

/// What the pumps do.
#[derive(Clone, Copy, Debug)]
struct Drive {
    /// Towards 0 Pa, latched or not; a set point is followed otherwise.
    vents: bool,
    target_pa: [f64; CHAMBERS_EACH],
    since_s: f64,
    /// The end of its time-to-live.
    until_s: f64,
    /// The regulators are, from [`PRELOAD_S`] after the beginning.
    enabled: bool,
}

impl Board {
    /// A board that has just booted; its first [`Self::poll`] sends HELLO.
    pub fn new(setup: BoardSetup) -> Self {
        let mut board = Self {
            setup,
            decoder: Decoder::default(),
            out: Vec::new(),
            seq: 0,
            config: None,
            heartbeat_s: None,
            drive: None,
            set_pa: [0.0; CHAMBERS_EACH],
            gauge_pa: [0.0; CHAMBERS_EACH],
            supply_cut: false,
            vent_limit_pa: [0.0; CHAMBERS_EACH],
            stop_open: false,
            stop_checks: 0,
            next_step_s: f64::MIN,
            latched: fault::SAFE | fault::BOOTED,
            last_reset: None,
            gauge_checks: 0,
            channel_faults: 0,
            gripper: Gripper::Open,
            gripper_known: false,
            next_check_s: f64::MIN,
            next_sample_ticks: f64::MIN,
        };
        board.say_hello(0.0);
        board
    }

    /// A reset: as [`Self::reboot`], but the memory keeps what is known of the gripper, and that the supply is cut.
    pub fn reset(&mut self, t_s: f64, boot_nonce: u32) {
        let (gripper_known, supply_cut) = (self.gripper_known, self.supply_cut);
        self.reboot(t_s, boot_nonce);
        (self.gripper_known, self.supply_cut) = (gripper_known, supply_cut);
    }

    /// Power off and on again: everything is forgotten, the clock starts at 0 at `t_s`. The gripper's valve stays where
    /// it is.
    pub fn reboot(&mut self, t_s: f64, boot_nonce: u32) {
        let gripper = self.gripper;
        *self = Self::new(BoardSetup {
            boot_nonce,
            clock_offset_s: 0.0,
            ..self.setup
        });
        self.gripper = gripper;
        self.setup.clock_offset_s = -self.clock_s(t_s);
    }

    /// Moves the board's clock (a fault): `by_s` seconds ahead.
    pub fn jump_clock(&mut self, by_s: f64) {
        self.setup.clock_offset_s += by_s;
        // The firmware's schedule counts elapsed ticks, so samples keep coming.
        self.next_sample_ticks += by_s * f64::from(self.setup.tick_rate_hz);
    }

    /// Reading of the board's clock at `t_s`, not wrapped, s.
    pub fn clock_s(&self, t_s: f64) -> f64 {
        self.ticks(t_s) / f64::from(self.setup.tick_rate_hz)
    }

    /// Which board this is, 0-based.
    pub fn id(&self) -> u8 {
        self.setup.id
    }

    /// Set gauge pressure of the board's chambers, Pa; `None`: pumps off.
    pub fn setpoint_pa(&self) -> Option<[f64; CHAMBERS_EACH]> {
        self.drive.filter(|d| d.enabled).map(|_| self.set_pa)
    }

    /// Whether the board lets the supply's air through.
    pub fn supplies(&self) -> bool {
        !self.supply_cut
    }

    /// Where the regulators are set, Pa; whether they are enabled or not.
    pub fn regulators_pa(&self) -> [f64; CHAMBERS_EACH] {
        self.set_pa
    }

    /// Where the gripper's valve is.
    pub fn gripper(&self) -> Gripper {
        self.gripper
    }

    /// Status bits, see [`fault`].
    pub fn status(&self) -> u16 {
        self.latched | self.channel_faults
    }

    /// Takes bytes from the host.
    pub fn on_bytes(&mut self, t_s: f64, bytes: &[u8]) {
        for byte in bytes {
            match self.decoder.push(*byte) {
                Some(Received::Packet(p)) if [self.setup.id, ALL_BOARDS].contains(&p.board) => {
                    self.on_packet(t_s, &p);
                }
                // A host of another version learns ours.
                Some(Received::OtherVersion { .. }) => self.say_hello(t_s),
                _ => {}
            }
        }
    }

    /// Runs the watchdogs and gives what the board sends: answers at once, a SAMPLE when due.
    pub fn poll(&mut self, t_s: f64, readings: &Readings) -> Vec<u8> {
        self.watch_host(t_s);
        if t_s >= self.next_check_s - SLACK_S {
            self.next_check_s = t_s + CHECK_PERIOD_S;
            self.check_chambers(t_s, readings);
        }
        if self.next_step_s < t_s - 1.0 {
            self.next_step_s = t_s;
        }
        self.gauge_pa = std::array::from_fn(|i| {
            let gauge = readings.chamber_pa[i].filter(|pa| pa.is_finite());
            gauge.unwrap_or(self.set_pa[i])
        });
        if t_s >= self.next_step_s - SLACK_S {
            self.check_stop(t_s, readings.stop_open);
        }
        while t_s >= self.next_step_s - SLACK_S {
            self.next_step_s += STEP_S;
            self.move_set_pressures(t_s);
        }
        let ticks = self.ticks(t_s);
        let rate = f64::from(self.setup.tick_rate_hz);
        if ticks >= self.next_sample_ticks - SLACK_S * rate {
            let period = rate / SAMPLE_RATE_HZ;
            // Samples that the caller slept through are gone; the rhythm stays.
            let late = ((ticks - self.next_sample_ticks) / period).clamp(0.0, 1e9);
            self.next_sample_ticks = if self.next_sample_ticks == f64::MIN {
                ticks + period
            } else {
                self.next_sample_ticks + (late + SLACK_S).floor().mul_add(period, period)
            };
            self.send_sample(t_s, readings);
        }
        std::mem::take(&mut self.out)
    }

    /// Board clock at `t_s`, not wrapped.
    fn ticks(&self, t_s: f64) -> f64 {
        let board_s = self.setup.clock_offset_s + self.setup.clock.elapsed_s(t_s);
        board_s * f64::from(self.setup.tick_rate_hz)
    }

    fn send(&mut self, t_s: f64, body: Body) {
        let mut flags = flag::SIMULATED;
        for (bit, set) in [
            (flag::CONFIGURED, self.config.is_some()),
            (flag::PUMPS_ON, self.drive.is_some()),
            (flag::VENTING, self.drive.is_some_and(|d| d.vents)),
            (
                flag::GRIPPER_CLOSED,
                self.gripper_known && self.gripper == Gripper::Closed,
            ),
            (flag::GRIPPER_AS_IT_WAS, !self.gripper_known),
            (flag::STOP_OPEN, self.stop_open),
            (flag::SUPPLY_CUT, self.supply_cut),
        ] {
            flags |= if set { bit } else { 0 };
        }
        let packet = Packet {
            board: self.setup.id,
            seq: self.seq,
            t_ticks: wrapped(self.ticks(t_s)),
            flags,
            body,
        };
        self.seq = self.seq.wrapping_add(1);
        encode(&packet, &mut self.out);
    }

    fn say_hello(&mut self, t_s: f64) {
        let hello = Hello {
            protocol: u16::from(VERSION),
            schema: SCHEMA_HASH,
            firmware: FIRMWARE_ID,
            tick_rate_hz: self.setup.tick_rate_hz,
            boot_nonce: self.setup.boot_nonce,
            config_crc: self.config.map_or(0, |c| c.crc()),
            rig: self.setup.rig,
        };
        self.send(t_s, Body::Hello(hello));
    }

    fn on_packet(&mut self, t_s: f64, packet: &Packet) {
        match &packet.body {
            Body::Ping { id } => {
                let pong = Body::Pong {
                    id: *id,
                    t_receive: wrapped(self.ticks(t_s)),
                };
                self.send(t_s, pong);
            }
            Body::Config(config) => {
                if config.is_allowed() {
                    self.config = Some(*config);
                }
                self.say_hello(t_s);
            }
            Body::Heartbeat => self.heartbeat_s = Some(t_s),
            Body::Estop { cause, cut } => {
                self.drive = None;
                self.supply_cut |= *cut;
                let one = cause.is_power_of_two() && cause & fault::OF_THE_HOST != 0;
                self.go_safe(t_s, if one { *cause } else { fault::ESTOP }, 0);
            }
            Body::Vent { ttl_ms } => self.on_vent(t_s, *ttl_ms),
            Body::Reset { id } => {
                if self.last_reset != Some(*id) {
                    self.last_reset = Some(*id);
                    self.leave_safe();
                }
            }
            Body::Setpoint(setpoint) => self.on_setpoint(t_s, setpoint, packet.flags),
            // What only boards send.
            Body::Hello(_) | Body::Sample(_) | Body::Pong { .. } | Body::Fault { .. } => {}
        }
    }

    /// Leaves SAFE. Causes that still hold trip again at the next check.
    fn leave_safe(&mut self) {
        self.latched = 0;
        self.drive = None;
        // The emergency stop keeps the supply cut.
        self.supply_cut &= self.stop_open;
        self.gauge_checks = 0;
        self.stop_checks = 0;
        // The watchdog starts again with the next heartbeat.
        self.heartbeat_s = None;
    }

    fn on_setpoint(&mut self, t_s: f64, setpoint: &Setpoint, flags: u16) {
        if setpoint.ttl_ms == 0 && self.drive.is_some_and(|d| !d.vents) {
            self.drive = None;
        }
        // Without heartbeats there is nobody to stop the arm later.
        let (Some(config), Some(_), 0) = (self.config, self.heartbeat_s, self.latched) else {
            return;
        };
        let [lo_pa, hi_pa] = [config.pressure_min, config.pressure_max].map(pressure_pa);
        let first = CHAMBERS_EACH * usize::from(self.setup.id);
        let target_pa = std::array::from_fn(|i| {
            let code = setpoint.pressure.get(first + i).copied();
            pressure_pa(code.unwrap_or(pressure_code(0.0))).clamp(lo_pa, hi_pa)
        });
        if !self.drive_to(t_s, false, target_pa, setpoint.ttl_ms) {
            return;
        }
        if flags & flag::GRIPPER_AS_IT_WAS == 0 {
            self.gripper_known = true;
            self.gripper = if flags & flag::GRIPPER_CLOSED != 0 {
                Gripper::Closed
            } else {
                Gripper::Open
            };
        }
    }

    fn on_vent(&mut self, t_s: f64, ttl_ms: u16) {
        let vents = self.drive.is_some_and(|d| d.vents);
        let has_air = self.gauge_pa.iter().any(|pa| pa.abs() > 2.0 * VENTED_PA);
        // An emergency stop that has been pressed is reset first.
        let stopped = self.stop_open || self.latched & fault::STOP_INPUT != 0;
        let is_allowed = (1..=LONGEST_TTL_MS).contains(&ttl_ms);
        if self.heartbeat_s.is_none() || stopped || !is_allowed {
            return;
        }
        if !vents && !has_air {
            self.drive = None;
            return;
        }
        if !vents {
            let bound_pa = self.bound_pa();
            self.vent_limit_pa = self
                .gauge_pa
                .map(|pa| bound_pa.max(pa.abs() + VENT_SLACK_PA));
        }
        self.drive_to(t_s, true, [0.0; CHAMBERS_EACH], ttl_ms);
    }

    /// Begins to move the set pressures, or goes on with it; whether the time-to-live allows that.
    fn drive_to(
        &mut self,
        t_s: f64,
        vents: bool,
        target_pa: [f64; CHAMBERS_EACH],
        ttl_ms: u16,
    ) -> bool {
        let is_allowed = (1..=LONGEST_TTL_MS).contains(&ttl_ms);
        if is_allowed {
            let (since_s, enabled) = self.drive.map_or((t_s, false), |d| (d.since_s, d.enabled));
            self.drive = Some(Drive {
                vents,
                target_pa,
                since_s,
                until_s: t_s + f64::from(ttl_ms) * 1e-3,
                enabled,
            });
        }
        is_allowed
    }

    /// Before the regulators are enabled they are set to the measured pressures, so that nothing jerks then.
    fn move_set_pressures(&mut self, t_s: f64) {
        let Some(drive) = self.drive else {
            return;
        };
        if !drive.enabled {
            let bound_pa = self.bound_pa();
            for (set_pa, gauge_pa) in self.set_pa.iter_mut().zip(self.gauge_pa) {
                // Beyond the bound the gauge may be what is wrong.
                if gauge_pa.abs() <= bound_pa {
                    *set_pa = gauge_pa;
                }
            }
            let Some(drive) = &mut self.drive else {
                return;
            };
            drive.enabled = t_s - drive.since_s >= PRELOAD_S - SLACK_S;
            return;
        }
        if drive.vents && self.gauge_pa.iter().all(|pa| pa.abs() <= VENTED_PA) {
            self.drive = None;
            return;
        }
        let most_pa = STEP_S * if drive.vents { VENT_PA_S } else { SLEW_PA_S };
        for (set_pa, target_pa) in self.set_pa.iter_mut().zip(drive.target_pa) {
            *set_pa += (target_pa - *set_pa).clamp(-most_pa, most_pa);
        }
    }

    fn check_stop(&mut self, t_s: f64, open: bool) {
        self.stop_open = open;
        if count_up(&mut self.stop_checks, open.then_some(0)) {
            self.drive = None;
            self.go_safe(t_s, fault::STOP_INPUT, 0);
        }
    }

    fn watch_host(&mut self, t_s: f64) {
        if let Some(drive) = self.drive
            && t_s > drive.until_s
        {
            self.drive = None;
            if !drive.vents {
                self.go_safe(t_s, fault::SETPOINT_EXPIRED, 0);
            }
        }
        let timeout_ms = self
            .config
            .unwrap_or(Config::built_in())
            .heartbeat_timeout_ms;
        if let Some(heard_s) = self.heartbeat_s
            && t_s - heard_s > f64::from(timeout_ms) * 1e-3
        {
            self.heartbeat_s = None;
            self.drive = None;
            self.go_safe(t_s, fault::HEARTBEAT_LOST, 0);
        }
    }

    /// The pressure beyond which a chamber is over-pressure, Pa.
    fn bound_pa(&self) -> f64 {
        pressure_pa(self.config.unwrap_or(Config::built_in()).over_pressure)
    }

    fn check_chambers(&mut self, t_s: f64, readings: &Readings) {
        let vents = self.drive.is_some_and(|d| d.vents);
        let limit_pa = match vents {
            true => self.vent_limit_pa,
            false => [self.bound_pa(); CHAMBERS_EACH],
        };
        let over = (0..CHAMBERS_EACH).find(|i| {
            readings.chamber_pa[*i].is_some_and(|pa| pa.is_infinite() || pa.abs() > limit_pa[*i])
        });
        let lost = readings
            .chamber_pa
            .iter()
            .position(|p| p.is_none_or(f64::is_nan));
        // A reading that falls to nothing passes the bound on its way: both count.
        if !count_up(&mut self.gauge_checks, over.or(lost)) {
            return;
        }
        if vents && over.is_some() {
            // A chamber that fills while it is vented is stopped, whatever was latched before.
            self.latched &= !fault::OVER_PRESSURE;
        }
        for (cause, found) in [(fault::OVER_PRESSURE, over), (fault::GAUGE_LOST, lost)] {
            if let Some(chamber) = found {
                self.go_safe(t_s, cause, chamber);
            }
        }
    }

    /// A cause that is latched already stops nothing again: chambers can be vented in spite of it.
    fn go_safe(&mut self, t_s: f64, cause: u16, chamber: usize) {
        if self.latched & cause == 0 {
            self.drive = None;
            self.latched |= fault::SAFE | cause;
            let first = CHAMBERS_EACH * usize::from(self.setup.id);
            let detail = if cause & (fault::OVER_PRESSURE | fault::GAUGE_LOST) != 0 {
                (first + chamber) as u32
            } else {
                0
            };
            self.send(
                t_s,
                Body::Fault {
                    code: cause,
                    detail,
                },
            );
        }
    }

    fn send_sample(&mut self, t_s: f64, readings: &Readings) {
        let board = usize::from(self.setup.id);
        let mut s = Sample::default();
        self.channel_faults = 0;
        for (k, spring) in readings.springs.iter().enumerate() {
            let i = SPRINGS_EACH * board + k;
            let fits = spring.and_then(|r| {
                let count = u16::try_from(r.count).ok()?;
                Some((count, u16::try_from(r.gate_ticks).ok()?))
            });
            match (fits, s.spring_counts.get_mut(i)) {
                (Some((count, gate)), Some(slot)) => {
                    *slot = count;
                    s.spring_gate_ticks[i] = gate;
                    s.present |= 1 << i;
                }
                _ => self.channel_faults |= fault::SPRING_LOST,
            }
        }
        for (k, imu) in readings.imus.iter().enumerate() {
            let i = IMUS_EACH * board + k;
            let sound = imu.filter(|r| {
                let all = r.gyro_rad_s.iter().chain(&r.accel_m_s2);
                all.into_iter().all(|x| x.is_finite())
            });
            match (sound, s.gyro.get_mut(i)) {
                (Some(reading), Some(slot)) => {
                    (*slot, s.accel[i]) = imu_codes(&reading);
                    s.present |= 1 << (SPRINGS + i);
                }
                _ => self.channel_faults |= fault::IMU_LOST,
            }
        }
        for (k, gauge) in readings.chamber_pa.iter().enumerate() {
            let i = CHAMBERS_EACH * board + k;
            if let (Some(pa), Some(slot)) = (gauge.filter(|p| !p.is_nan()), s.pressure.get_mut(i)) {
                *slot = pressure_code(pa);
                s.present |= 1 << (SPRINGS + IMUS + i);
            }
        }
        s.status = self.status();
        self.send(t_s, Body::Sample(s));
    }
}

/// Counts checks running in which something was found; true once there are enough.
fn count_up(checks: &mut u8, found: Option<usize>) -> bool {
    *checks = if found.is_some() {
        checks.saturating_add(1)
    } else {
        0
    };
    *checks >= CHECKS_TO_TRIP
}

/// The clock as the board's 32-bit counter shows it.
fn wrapped(ticks: f64) -> u32 {
    (ticks.floor() as i64) as u32
}
