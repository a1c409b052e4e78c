/* Firmware of both boards of the arm. One source, one binary: a strap tells which board it is.
 *
 * What must never depend on the host is here: SAFE (pumps off, latched until a RESET with a new
 * id) holds from the start, and is entered on ESTOP, when heartbeats stop for 200 ms, when a set
 * point is not renewed in time, when the emergency stop's contact opens, and when a chamber is
 * beyond +-42 kPa or its gauge gives no value in two checks running, one every 5 ms. Set points are
 * clamped to +-40 kPa, and followed only while they are fresh, heartbeats come, and a CONFIG has
 * been accepted since boot; the set pressures begin at the measured ones and move by 15 kPa/s at
 * most. A main loop that hangs is ended by the watchdog.
 */
#include <avr/wdt.h>
#include <string.h>

#include "hal.h"
#include "wire.h"

#define FIRMWARE_ID 0x41565231UL /* "AVR1" */

#define SAMPLE_TICKS (TICK_RATE_HZ / SAMPLE_RATE_HZ)
#define CHECKS_TO_TRIP 2
/* A PONG is encoded within this time: 0.4 ms, and what interrupts take. */
#define PONG_TICKS (TICKS_PER_MS / 2)
/* Gauges that have not been converted for so long are lost. */
#define GAUGES_PATIENCE (20 * TICKS_PER_MS)
/* The emergency stop is looked at, and set pressures are moved, this often. */
#define STEP_TICKS (4 * TICKS_PER_MS)
#define STEPS_PER_S (TICK_RATE_HZ / STEP_TICKS)
#define PRELOAD_TICKS (PRELOAD_MS * TICKS_PER_MS)
#define ZERO_PRESSURE 32768U
/* A chamber that is vented may show so much more than at the beginning: 1 kPa. */
#define VENT_SLACK 500U

/* A host may ask for narrower limits than these, never for wider ones. */
static const config_t BUILT_IN = {PRESSURE_MIN, PRESSURE_MAX, OVER_PRESSURE, HEARTBEAT_TIMEOUT_MS};

static uint8_t board;
static bool simulated;
static uint32_t boot_nonce;
static uint16_t seq;

static config_t config;
static uint32_t config_crc; /* 0: none accepted since boot */

static bool heart_beats;
static uint32_t heartbeat_ticks;

/* Off, or following a set point, or venting. */
static enum { OFF, FOLLOWING, VENTING } drive;
static uint32_t renewed, valid_for; /* the set point's age and life, ticks */
static bool enabled;                /* the regulators: from PRELOAD_TICKS after the start of the drive */
static uint32_t drive_from;
static uint16_t target[CHAMBERS_EACH], set[CHAMBERS_EACH] = {ZERO_PRESSURE, ZERO_PRESSURE, ZERO_PRESSURE};
static uint16_t vent_limit[CHAMBERS_EACH]; /* chambers further from 0 than this are not vented on */
static uint32_t next_step;

static uint16_t latched = FAULT_SAFE | FAULT_BOOTED;
static bool stop_open;
static uint8_t stop_checks;
static bool reset_seen;
static uint32_t last_reset;

static uint16_t gauge_code[CHAMBERS_EACH];
static bool gauge_valid[CHAMBERS_EACH];
static uint32_t gauges_ticks;
static uint8_t gauge_checks;
static uint16_t channel_faults;

/* ---- to the host ------------------------------------------------------------------------------ */

/* Gives the length of the frame. */
static size_t frame_of(uint32_t t_ticks, uint8_t type, const void *payload, size_t n, uint8_t frame[BOARD_FRAME_MAX])
{
    header_t h = {PROTOCOL_VERSION, type, board, seq++, t_ticks, 0};
    if (config_crc)
        h.flags |= FLAG_CONFIGURED;
    if (drive != OFF)
        h.flags |= FLAG_PUMPS_ON;
    if (drive == VENTING)
        h.flags |= FLAG_VENTING;
    if (hal_gripper_closed())
        h.flags |= FLAG_GRIPPER_CLOSED;
    if (!hal_gripper_known())
        h.flags |= FLAG_GRIPPER_AS_IT_WAS;
    if (stop_open)
        h.flags |= FLAG_STOP_OPEN;
    if (hal_supply_cut())
        h.flags |= FLAG_SUPPLY_CUT;
    if (simulated)
        h.flags |= FLAG_SIMULATED;
    return wire_encode(&h, payload, n, frame);
}

static void say_at(uint32_t t_ticks, uint8_t type, const void *payload, size_t n)
{
    uint8_t frame[BOARD_FRAME_MAX];
    /* No room means that the line is far behind: the gap in seq tells the host. */
    hal_send(frame, frame_of(t_ticks, type, payload, n, frame));
}

static void say(uint8_t type, const void *payload, size_t n)
{
    say_at(hal_ticks(), type, payload, n);
}

static void say_hello(void)
{
    const hello_t h = {PROTOCOL_VERSION, SCHEMA_HASH, FIRMWARE_ID, TICK_RATE_HZ, boot_nonce, config_crc,
                       hal_rig()};
    say(MSG_HELLO, &h, sizeof h);
}

/* A PONG says when it goes out, and the host takes out of the round trip whatever it waited for here: for a sample that
 * was still going out, or, on an idle line, for its own encoding, which it is given a fixed time for. */
static void say_pong(const pong_t *p)
{
    uint8_t frame[BOARD_FRAME_MAX];
    const uint32_t ready = hal_ticks() + PONG_TICKS;
    uint32_t t_ticks = hal_send_ticks();
    const bool idle = (int32_t)(ready - t_ticks) > 0;
    if (idle)
        t_ticks = ready;
    const size_t n = frame_of(t_ticks, MSG_PONG, p, sizeof *p, frame);
    while (idle && (int32_t)(hal_ticks() - t_ticks) < 0)
        ;
    hal_send(frame, n);
}

/* ---- safety ------------------------------------------------------------------------------------- */

static void pumps_off(void)
{
    drive = OFF;
    enabled = false;
    hal_pumps(false);
}

/* A cause that is latched already stops nothing again: chambers can be vented in spite of it. */
static void go_safe(uint16_t cause, uint32_t detail)
{
    if (latched & cause)
        return;
    pumps_off();
    latched |= FAULT_SAFE | cause;
    const fault_t f = {cause, detail};
    say(MSG_FAULT, &f, sizeof f);
}

/* Counts checks running in which something was found; true once there are enough. */
static bool count_up(uint8_t *checks, bool found)
{
    if (!found)
        *checks = 0;
    else if (*checks < CHECKS_TO_TRIP)
        ++*checks;
    return *checks >= CHECKS_TO_TRIP;
}

static void watch_host(uint32_t now)
{
    if (drive != OFF && now - renewed > valid_for) {
        const bool followed = drive == FOLLOWING;
        pumps_off();
        if (followed)
            go_safe(FAULT_SETPOINT_EXPIRED, 0);
    }
    const uint16_t timeout_ms = config_crc ? config.heartbeat_timeout_ms : HEARTBEAT_TIMEOUT_MS;
    if (heart_beats && now - heartbeat_ticks > timeout_ms * TICKS_PER_MS) {
        heart_beats = false;
        pumps_off();
        go_safe(FAULT_HEARTBEAT_LOST, 0);
    }
}

/* ---- set pressures ------------------------------------------------------------------------------ */

/* How far from 0, above or below it. */
static uint16_t magnitude(uint16_t code)
{
    return code > ZERO_PRESSURE ? code - ZERO_PRESSURE : ZERO_PRESSURE - code;
}

static uint16_t bound(void)
{
    return magnitude(config_crc ? config.over_pressure : OVER_PRESSURE);
}

/* Starts from the measured pressures, so that nothing jerks when the regulators are enabled. A chamber without a gauge
 * starts from where it was set last, and so does one beyond the bound: its gauge may be what is wrong. */
static void preload(void)
{
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++)
        if (gauge_valid[i] && magnitude(gauge_code[i]) <= bound())
            set[i] = gauge_code[i];
    hal_regulators(set);
}

static void begin(uint8_t how, uint32_t now)
{
    if (drive == OFF) {
        drive_from = now;
        preload();
    }
    drive = how;
}

/* A chamber without a gauge counts as where it was set last. */
static bool all_within(uint16_t steps)
{
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        const uint16_t p = gauge_valid[i] ? gauge_code[i] : set[i];
        if (p > ZERO_PRESSURE + steps || p < ZERO_PRESSURE - steps)
            return false;
    }
    return true;
}

static void approach(uint16_t most)
{
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        if (set[i] < target[i])
            set[i] = target[i] - set[i] > most ? set[i] + most : target[i];
        else
            set[i] = set[i] - target[i] > most ? set[i] - most : target[i];
    }
    hal_regulators(set);
}

static void drive_step(uint32_t now)
{
    if (drive == VENTING && enabled && all_within(VENTED)) {
        pumps_off();
    } else if (drive != OFF && !enabled) {
        preload();
        if (now - drive_from >= PRELOAD_TICKS) {
            enabled = true;
            hal_pumps(true);
        }
    } else if (drive != OFF) {
        approach(drive == VENTING ? VENT_PER_S / STEPS_PER_S : SLEW_PER_S / STEPS_PER_S);
    }
}

static void check_stop(void)
{
    stop_open = hal_stop_open();
    if (count_up(&stop_checks, stop_open)) {
        pumps_off();
        go_safe(FAULT_STOP_INPUT, 0);
    }
}

/* What is done every STEP_TICKS. Set pressures make up for what was slept through; a contact that is looked at twice
 * at once has been looked at once. */
static void every_step(uint32_t now)
{
    hal_gripper_tick();
    if ((int32_t)(now - next_step) < 0)
        return;
    check_stop();
    while ((int32_t)(now - next_step) >= 0) {
        next_step += STEP_TICKS;
        drive_step(now);
    }
}

/* The code of the pressure with the other sign. */
static uint16_t mirrored(uint16_t code)
{
    return (uint16_t)(65536UL - code);
}

static void check_gauges(uint32_t now)
{
    if (hal_gauges(gauge_code, gauge_valid)) {
        gauges_ticks = now;
    } else if (now - gauges_ticks > GAUGES_PATIENCE) {
        gauges_ticks = now;
        memset(gauge_valid, 0, sizeof gauge_valid);
    } else {
        return;
    }
    const bool vents = drive == VENTING;
    uint8_t over = CHAMBERS_EACH, lost = CHAMBERS_EACH;
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        if (lost == CHAMBERS_EACH && !gauge_valid[i])
            lost = i;
        if (over == CHAMBERS_EACH && gauge_valid[i] &&
            magnitude(gauge_code[i]) > (vents ? vent_limit[i] : bound()))
            over = i;
    }
    /* A reading that falls to nothing passes the bound on its way: both count. */
    if (!count_up(&gauge_checks, over < CHAMBERS_EACH || lost < CHAMBERS_EACH))
        return;
    /* A chamber that fills while it is vented is stopped, whatever was latched before. */
    if (vents && over < CHAMBERS_EACH)
        latched &= ~FAULT_OVER_PRESSURE;
    const uint8_t first = CHAMBERS_EACH * board;
    if (over < CHAMBERS_EACH)
        go_safe(FAULT_OVER_PRESSURE, first + over);
    if (lost < CHAMBERS_EACH)
        go_safe(FAULT_GAUGE_LOST, first + lost);
}

/* ---- from the host ------------------------------------------------------------------------------ */

static bool is_allowed(const config_t *c)
{
    return c->pressure_min >= BUILT_IN.pressure_min && c->pressure_max <= BUILT_IN.pressure_max &&
           c->pressure_min < c->pressure_max && c->over_pressure >= c->pressure_max &&
           c->pressure_min >= mirrored(c->over_pressure) &&
           c->over_pressure <= BUILT_IN.over_pressure && c->heartbeat_timeout_ms >= 1 &&
           c->heartbeat_timeout_ms <= BUILT_IN.heartbeat_timeout_ms;
}

static void on_config(const config_t *wanted)
{
    if (is_allowed(wanted)) {
        config = *wanted;
        config_crc = crc32(&config, sizeof config);
        if (!config_crc)
            config_crc = 1;
    }
    say_hello();
}

/* Causes that still hold trip again at the next check. */
static void on_reset(uint32_t id)
{
    if (reset_seen && id == last_reset)
        return;
    reset_seen = true;
    last_reset = id;
    latched = 0;
    gauge_checks = stop_checks = 0;
    if (!stop_open) /* the emergency stop keeps it cut */
        hal_supply(true);
    heart_beats = false; /* the watchdog starts again with the next heartbeat */
    pumps_off();
}

static void on_setpoint(const setpoint_t *s, uint16_t flags, uint32_t now)
{
    if (s->ttl_ms == 0 && drive == FOLLOWING)
        pumps_off();
    /* Without heartbeats there is nobody to stop the arm later. */
    if (!config_crc || !heart_beats || latched || s->ttl_ms == 0 || s->ttl_ms > LONGEST_TTL_MS)
        return;
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        uint16_t c = s->pressure[CHAMBERS_EACH * board + i];
        c = c < config.pressure_min ? config.pressure_min : c;
        target[i] = c > config.pressure_max ? config.pressure_max : c;
    }
    begin(FOLLOWING, now);
    renewed = now;
    valid_for = (uint32_t)s->ttl_ms * TICKS_PER_MS;
    if (!(flags & FLAG_GRIPPER_AS_IT_WAS))
        hal_gripper(flags & FLAG_GRIPPER_CLOSED);
}

static void on_vent(uint16_t ttl_ms, uint32_t now)
{
    /* An emergency stop that has been pressed is reset first. */
    if (!heart_beats || stop_open || (latched & FAULT_STOP_INPUT) || ttl_ms == 0 || ttl_ms > LONGEST_TTL_MS)
        return;
    if (drive != VENTING && all_within(2 * VENTED)) {
        pumps_off();
        return;
    }
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        target[i] = ZERO_PRESSURE;
        if (drive != VENTING) {
            const uint16_t from = gauge_valid[i] ? magnitude(gauge_code[i]) + VENT_SLACK : 0;
            vent_limit[i] = from > bound() ? from : bound();
        }
    }
    begin(VENTING, now);
    renewed = now;
    valid_for = (uint32_t)ttl_ms * TICKS_PER_MS;
}

static void on_estop(const estop_t *e)
{
    const uint16_t cause = e->cause;
    const uint16_t one = cause & (cause - 1) ? 0 : cause & (FAULT_ESTOP | FAULT_ENDED | FAULT_CONTROL_SILENT);
    pumps_off();
    if (e->cut)
        hal_supply(false);
    go_safe(one ? one : FAULT_ESTOP, 0);
}

static void on_message(const header_t *h, const void *payload, size_t n, uint32_t t_ticks)
{
    switch (h->type) {
    case MSG_SETPOINT:
        if (n == sizeof(setpoint_t))
            on_setpoint(payload, h->flags, t_ticks);
        break;
    case MSG_HEARTBEAT:
        if (n == 0) {
            heart_beats = true;
            heartbeat_ticks = t_ticks;
        }
        break;
    case MSG_ESTOP:
        if (n == sizeof(estop_t))
            on_estop(payload);
        break;
    case MSG_VENT:
        if (n == sizeof(vent_t))
            on_vent(((const vent_t *)payload)->ttl_ms, t_ticks);
        break;
    case MSG_RESET:
        if (n == sizeof(reset_t)) {
            uint32_t id;
            memcpy(&id, payload, 4);
            on_reset(id);
        }
        break;
    case MSG_CONFIG:
        if (n == sizeof(config_t))
            on_config(payload);
        break;
    case MSG_PING:
        if (n == sizeof(ping_t)) {
            pong_t p = {0, t_ticks};
            memcpy(&p.id, payload, 4);
#ifdef HANG_ON_PING /* for the test of the watchdog */
            while (p.id == HANG_ON_PING)
                ;
#endif
            say_pong(&p);
        }
        break;
    }
}

static void listen(void)
{
    host_frame_t f;
    while (hal_receive(&f)) {
        size_t n = wire_decode(f.bytes, f.n);
        if (!n)
            continue;
        const header_t *h = (const header_t *)f.bytes;
        if (h->version != PROTOCOL_VERSION)
            say_hello(); /* a host of another version learns ours */
        else if (h->board == board || h->board == ALL_BOARDS)
            on_message(h, f.bytes + sizeof *h, n - sizeof *h, f.t_ticks);
        /* Frames take a while, and a conversion of the gauges that nobody looked at is gone. */
        check_gauges(hal_ticks());
    }
}

/* ---- samples ------------------------------------------------------------------------------------ */

static void send_sample(uint32_t t_ticks)
{
    static sample_t s;
    memset(&s, 0, sizeof s);
    channel_faults = 0;

    counter_t counter[SPRINGS_EACH];
    hal_counters(counter);
    for (uint8_t k = 0; k < SPRINGS_EACH; k++) {
        const uint8_t i = SPRINGS_EACH * board + k;
        if (counter[k].gate_ticks) {
            s.spring_counts[i] = counter[k].count;
            s.spring_gate_ticks[i] = counter[k].gate_ticks;
            s.present |= 1UL << i;
        } else {
            channel_faults |= FAULT_SPRING_LOST;
        }
    }
    for (uint8_t k = 0; k < IMUS_EACH; k++) {
        const uint8_t i = IMUS_EACH * board + k;
        if (hal_imu(k, &s.gyro[3 * i], &s.accel[3 * i]))
            s.present |= 1UL << (12 + i);
        else
            channel_faults |= FAULT_IMU_LOST;
    }
    /* The IMUs take a while, and so does what follows. */
    check_gauges(hal_ticks());
    for (uint8_t k = 0; k < CHAMBERS_EACH; k++) {
        const uint8_t i = CHAMBERS_EACH * board + k;
        if (gauge_valid[k]) {
            s.pressure[i] = gauge_code[k];
            s.present |= 1UL << (16 + i);
        }
    }
    s.status = latched | channel_faults;
    say_at(t_ticks, MSG_SAMPLE, &s, sizeof s);
}

int main(void)
{
    hal_init();
    wdt_enable(WDTO_60MS);
    board = hal_board();
    simulated = hal_simulated();
    boot_nonce = hal_boot_nonce(board);
    say_hello();

    uint32_t next_sample = hal_ticks() + SAMPLE_TICKS / 2;
    gauges_ticks = next_step = hal_ticks();
    hal_supply(!hal_supply_cut());
    for (;;) {
        wdt_reset();
        listen();
        uint32_t now = hal_ticks();
        watch_host(now);
        check_gauges(now);
        every_step(now);
        if ((int32_t)(now - next_sample) >= 0) {
            /* Samples that were slept through are gone; the rhythm stays. */
            while ((int32_t)(now - next_sample) >= 0)
                next_sample += SAMPLE_TICKS;
            send_sample(now);
        }
        hal_wait();
    }
}
