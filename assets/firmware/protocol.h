/* Wire protocol and limits, made from src/link/wire. Do not edit: change them there, then run
 *   SPRINGTWIN_WRITE_ASSETS=1 cargo test --lib link::wire::header */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <stdint.h>

/* The tests build boards that do not match by setting these from outside. */
#ifndef PROTOCOL_VERSION
#define PROTOCOL_VERSION 2
#endif
#ifndef SCHEMA_HASH /* CRC-32 of the layout in words */
#define SCHEMA_HASH 0xcca5074eUL
#endif
#ifndef PRESSURE_MIN
#define PRESSURE_MIN 12768U
#endif
#define PRESSURE_MAX 52768U
#define OVER_PRESSURE 53768U
#define HEARTBEAT_TIMEOUT_MS 200
#define LONGEST_TTL_MS 250
#define PRELOAD_MS 50
/* Steps of pressure per second and of pressure, 2 Pa each. */
#define SLEW_PER_S 7500UL
#define VENT_PER_S 6000UL
#define VENTED 500U

#define BAUD 500000UL
#define TICK_RATE_HZ 2000000UL
#define SAMPLE_RATE_HZ 100
#define ALL_BOARDS 0xff
#define PACKED __attribute__((packed))

enum message {
    MSG_HELLO = 0x01,
    MSG_SAMPLE = 0x02,
    MSG_PONG = 0x03,
    MSG_FAULT = 0x04,
    MSG_SETPOINT = 0x81,
    MSG_HEARTBEAT = 0x82,
    MSG_ESTOP = 0x83,
    MSG_RESET = 0x84,
    MSG_CONFIG = 0x85,
    MSG_PING = 0x86,
    MSG_VENT = 0x87,
};

/* Bits of the header's flags. */
enum {
    FLAG_CONFIGURED = 1 << 0,
    FLAG_PUMPS_ON = 1 << 1,
    FLAG_GRIPPER_CLOSED = 1 << 2,
    FLAG_SIMULATED = 1 << 3,
    FLAG_GRIPPER_AS_IT_WAS = 1 << 4,
    FLAG_STOP_OPEN = 1 << 5,
    FLAG_SUPPLY_CUT = 1 << 6,
    FLAG_VENTING = 1 << 7,
};

/* Bits of a SAMPLE's status. */
enum {
    FAULT_SAFE = 1 << 0,
    FAULT_ESTOP = 1 << 1,
    FAULT_HEARTBEAT_LOST = 1 << 2,
    FAULT_OVER_PRESSURE = 1 << 3,
    FAULT_GAUGE_LOST = 1 << 4,
    FAULT_SETPOINT_EXPIRED = 1 << 5,
    FAULT_SPRING_LOST = 1 << 6,
    FAULT_IMU_LOST = 1 << 7,
    FAULT_BOOTED = 1 << 8,
    FAULT_STOP_INPUT = 1 << 9,
    FAULT_ENDED = 1 << 10,
    FAULT_CONTROL_SILENT = 1 << 11,
};

typedef struct PACKED {
    uint8_t version;
    uint8_t type;
    uint8_t board;
    uint16_t seq;
    uint32_t t_ticks;
    uint16_t flags;
} header_t;
_Static_assert(sizeof(header_t) == 11, "header takes 11 bytes on the line");

typedef struct PACKED {
    uint16_t protocol;
    uint32_t schema;
    uint32_t firmware;
    uint32_t tick_rate_hz;
    uint32_t boot_nonce;
    uint32_t config_crc;
    uint32_t rig;
} hello_t;
_Static_assert(sizeof(hello_t) == 26, "hello takes 26 bytes on the line");

typedef struct PACKED {
    uint16_t spring_counts[12];
    uint16_t spring_gate_ticks[12];
    int16_t gyro[12];
    int16_t accel[12];
    uint16_t pressure[6];
    uint32_t present;
    uint16_t status;
} sample_t;
_Static_assert(sizeof(sample_t) == 114, "sample takes 114 bytes on the line");

typedef struct PACKED {
    uint32_t id;
    uint32_t t_receive;
} pong_t;
_Static_assert(sizeof(pong_t) == 8, "pong takes 8 bytes on the line");

typedef struct PACKED {
    uint16_t code;
    uint32_t detail;
} fault_t;
_Static_assert(sizeof(fault_t) == 6, "fault takes 6 bytes on the line");

typedef struct PACKED {
    uint16_t pressure[6];
    uint16_t ttl_ms;
} setpoint_t;
_Static_assert(sizeof(setpoint_t) == 14, "setpoint takes 14 bytes on the line");

typedef struct PACKED {
    uint16_t cause;
    uint16_t cut;
} estop_t;
_Static_assert(sizeof(estop_t) == 4, "estop takes 4 bytes on the line");

typedef struct PACKED {
    uint32_t id;
} reset_t;
_Static_assert(sizeof(reset_t) == 4, "reset takes 4 bytes on the line");

typedef struct PACKED {
    uint16_t pressure_min;
    uint16_t pressure_max;
    uint16_t over_pressure;
    uint16_t heartbeat_timeout_ms;
} config_t;
_Static_assert(sizeof(config_t) == 8, "config takes 8 bytes on the line");

typedef struct PACKED {
    uint32_t id;
    uint32_t pad;
} ping_t;
_Static_assert(sizeof(ping_t) == 8, "ping takes 8 bytes on the line");

typedef struct PACKED {
    uint16_t ttl_ms;
} vent_t;
_Static_assert(sizeof(vent_t) == 2, "vent takes 2 bytes on the line");

#endif
