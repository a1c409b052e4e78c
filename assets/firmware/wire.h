/* Wire protocol, version 2: 00 | COBS(header, payload, CRC-32) | 00, little-endian like the AVR itself. */
#ifndef WIRE_H
#define WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "protocol.h"

/* Longest frame from the host between its delimiters, and longest frame to it with both. */
#define HOST_FRAME_MAX 40
#define BOARD_FRAME_MAX (sizeof(header_t) + sizeof(sample_t) + 4 + 3)
_Static_assert(sizeof(header_t) + sizeof(setpoint_t) + 4 + 1 <= HOST_FRAME_MAX, "a SETPOINT fits");
_Static_assert(sizeof(header_t) + sizeof(sample_t) + 4 < 254, "one COBS block holds any frame");

/* CRC-32 (ISO-HDLC) of `n` bytes. */
uint32_t crc32(const void *bytes, size_t n);

/* Writes the frame of a message to `out` (at least BOARD_FRAME_MAX bytes); gives its length. */
size_t wire_encode(const header_t *header, const void *payload, size_t n, uint8_t *out);

/* Undoes COBS and checks the CRC of what stood between two delimiters, in place. Gives the length
 * of header and payload, or 0 for a frame that is not sound. */
size_t wire_decode(uint8_t *frame, size_t n);

#endif
