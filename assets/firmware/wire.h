/* Wire protocol, version 1: 00 | COBS(header, payload, CRC-32) | 00, little-endian like the AVR itself. */
#ifndef WIRE_H
#define WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The tests build boards that do not match by setting these from outside. */
#ifndef PROTOCOL_VERSION
#define PROTOCOL_VERSION 1
#endif
/* CRC-32 of the layout in words, as the host computes it. */
#ifndef SCHEMA_HASH
#define SCHEMA_HASH 0x9c699d9dUL
#endif

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
};

/* Bits of the header's flags. */
enum {
    FLAG_CONFIGURED = 1 << 0,
    FLAG_PUMPS_ON = 1 << 1,
    FLAG_GRIPPER_CLOSED = 1 << 2,
    FLAG_SIMULATED = 1 << 3,
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
};

typedef struct PACKED {
    uint8_t version, type, board;
    uint16_t seq;
    uint32_t t_ticks;
    uint16_t flags;
} header_t;

typedef struct PACKED {
    uint16_t protocol;
    uint32_t schema, firmware, tick_rate_hz, boot_nonce, config_crc;
} hello_t;

typedef struct PACKED {
    uint16_t spring_counts[12], spring_gate_ticks[12];
    int16_t gyro[4][3], accel[4][3];
    uint16_t pressure[6];
    uint32_t present;
    uint16_t status;
} sample_t;

typedef struct PACKED {
    uint32_t id, t_receive;
} pong_t;

typedef struct PACKED {
    uint16_t code;
    uint32_t detail;
} fault_t;

typedef struct PACKED {
    uint16_t pressure[6];
    uint16_t ttl_ms;
} setpoint_t;

typedef struct PACKED {
    uint16_t pressure_min, pressure_max, over_pressure, heartbeat_timeout_ms;
} config_t;

/* Longest frame from the host between its delimiters, and longest frame to it with both. */
#define HOST_FRAME_MAX 40
#define BOARD_FRAME_MAX (sizeof(header_t) + sizeof(sample_t) + 4 + 3)

/* CRC-32 (ISO-HDLC) of `n` bytes. */
uint32_t crc32(const void *bytes, size_t n);

/* Writes the frame of a message to `out` (at least BOARD_FRAME_MAX bytes); gives its length. */
size_t wire_encode(const header_t *header, const void *payload, size_t n, uint8_t *out);

/* Undoes COBS and checks the CRC of what stood between two delimiters, in place. Gives the length
 * of header and payload, or 0 for a frame that is not sound. */
size_t wire_decode(uint8_t *frame, size_t n);

#endif
