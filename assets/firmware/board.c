/* Firmware of both boards of the arm. One source, one binary: a strap tells which board it is.
 *
 * What must never depend on the host is here: SAFE (pumps off, latched until a RESET with a new
 * id) is entered on ESTOP, when heartbeats stop for 200 ms, and when a chamber is beyond +-42 kPa
 * or its gauge gives no value in two checks running, one every 5 ms. Set points are clamped to
 * +-40 kPa and followed only while they are fresh, heartbeats come, and a CONFIG has been accepted
 * since boot. A main loop that hangs is ended by the watchdog; a board that boots does not move.
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

static bool driven;
static uint32_t driven_from, driven_for;
static bool expired;
static bool gripper_closed;

static uint16_t latched;
static bool reset_seen;
static uint32_t last_reset;

static uint16_t gauge_code[CHAMBERS_EACH];
static bool gauge_valid[CHAMBERS_EACH];
static uint32_t gauges_ticks;
static uint8_t over_checks, lost_checks;
static uint16_t channel_faults;

/* ---- to the host ------------------------------------------------------------------------------ */

/* Gives the length of the frame. */
static size_t frame_of(uint32_t t_ticks, uint8_t type, const void *payload, size_t n, uint8_t frame[BOARD_FRAME_MAX])
{
    header_t h = {PROTOCOL_VERSION, type, board, seq++, t_ticks, 0};
    if (config_crc)
        h.flags |= FLAG_CONFIGURED;
    if (driven)
        h.flags |= FLAG_PUMPS_ON;
    if (gripper_closed)
        h.flags |= FLAG_GRIPPER_CLOSED;
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
    const hello_t h = {PROTOCOL_VERSION, SCHEMA_HASH, FIRMWARE_ID, TICK_RATE_HZ, boot_nonce, config_crc};
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
    driven = false;
    hal_pumps(NULL);
}

static void go_safe(uint16_t cause, uint32_t detail)
{
    pumps_off();
    if (latched & cause)
        return;
    latched |= FAULT_SAFE | cause;
    const fault_t f = {cause, detail};
    say(MSG_FAULT, &f, sizeof f);
}

static void watch_host(uint32_t now)
{
    if (driven && now - driven_from > driven_for) {
        pumps_off();
        expired = true;
    }
    const uint16_t timeout_ms = config_crc ? config.heartbeat_timeout_ms : HEARTBEAT_TIMEOUT_MS;
    if (heart_beats && now - heartbeat_ticks > timeout_ms * TICKS_PER_MS) {
        heart_beats = false;
        go_safe(FAULT_HEARTBEAT_LOST, 0);
    }
}

/* The code of the pressure with the other sign. */
static uint16_t mirrored(uint16_t code)
{
    return (uint16_t)(65536UL - code);
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
    const uint16_t high = config_crc ? config.over_pressure : OVER_PRESSURE;
    const uint16_t low = mirrored(high);
    uint8_t over = CHAMBERS_EACH, lost = CHAMBERS_EACH;
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        if (lost == CHAMBERS_EACH && !gauge_valid[i])
            lost = i;
        if (over == CHAMBERS_EACH && gauge_valid[i] && (gauge_code[i] > high || gauge_code[i] < low))
            over = i;
    }
    const uint8_t first = CHAMBERS_EACH * board;
    if (count_up(&over_checks, over < CHAMBERS_EACH))
        go_safe(FAULT_OVER_PRESSURE, first + (over < CHAMBERS_EACH ? over : 0));
    if (count_up(&lost_checks, lost < CHAMBERS_EACH))
        go_safe(FAULT_GAUGE_LOST, first + (lost < CHAMBERS_EACH ? lost : 0));
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
    expired = false;
    over_checks = lost_checks = 0;
    heart_beats = false; /* the watchdog starts again with the next heartbeat */
    pumps_off();
}

static void on_setpoint(const setpoint_t *s, uint16_t flags, uint32_t now)
{
    /* Without heartbeats there is nobody to stop the arm later. */
    if (!config_crc || !heart_beats || latched)
        return;
    uint16_t code[CHAMBERS_EACH];
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        uint16_t c = s->pressure[CHAMBERS_EACH * board + i];
        c = c < config.pressure_min ? config.pressure_min : c;
        code[i] = c > config.pressure_max ? config.pressure_max : c;
    }
    driven = true;
    driven_from = now;
    driven_for = (uint32_t)s->ttl_ms * TICKS_PER_MS;
    expired = false;
    hal_pumps(code);
    gripper_closed = flags & FLAG_GRIPPER_CLOSED;
    hal_gripper(gripper_closed);
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
        if (n == 0)
            go_safe(FAULT_ESTOP, 0);
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
    for (uint8_t k = 0; k < CHAMBERS_EACH; k++) {
        const uint8_t i = CHAMBERS_EACH * board + k;
        if (gauge_valid[k]) {
            s.pressure[i] = gauge_code[k];
            s.present |= 1UL << (16 + i);
        }
    }
    s.status = latched | channel_faults | (expired ? FAULT_SETPOINT_EXPIRED : 0);
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

    uint32_t next_sample = hal_ticks() + SAMPLE_TICKS;
    gauges_ticks = hal_ticks();
    for (;;) {
        wdt_reset();
        listen();
        uint32_t now = hal_ticks();
        watch_host(now);
        check_gauges(now);
        if ((int32_t)(now - next_sample) >= 0) {
            /* Samples that were slept through are gone; the rhythm stays. */
            while ((int32_t)(now - next_sample) >= 0)
                next_sample += SAMPLE_TICKS;
            send_sample(now);
        }
        hal_wait();
    }
}
