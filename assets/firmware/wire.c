#include "wire.h"

#include <string.h>

#include <avr/pgmspace.h>

/* One entry per half byte: a whole table would not fit beside the buffers. */
static const uint32_t CRC_TABLE[16] PROGMEM = {
    0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
    0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c,
};

uint32_t crc32(const void *bytes, size_t n)
{
    const uint8_t *b = bytes;
    uint32_t crc = 0xffffffff;
    while (n--) {
        crc ^= *b++;
        crc = (crc >> 4) ^ pgm_read_dword(&CRC_TABLE[crc & 15]);
        crc = (crc >> 4) ^ pgm_read_dword(&CRC_TABLE[crc & 15]);
    }
    return ~crc;
}

size_t wire_encode(const header_t *header, const void *payload, size_t n, uint8_t *out)
{
    uint8_t raw[sizeof(header_t) + sizeof(sample_t) + 4];
    memcpy(raw, header, sizeof *header);
    memcpy(raw + sizeof *header, payload, n);
    n += sizeof *header;
    uint32_t crc = crc32(raw, n);
    memcpy(raw + n, &crc, 4);
    n += 4;

    /* No frame reaches 254 bytes, so a code byte never runs full. */
    size_t at = 0;
    out[at++] = 0;
    size_t code = at++;
    out[code] = 1;
    for (size_t i = 0; i < n; i++) {
        if (raw[i]) {
            out[at++] = raw[i];
            out[code]++;
        } else {
            code = at++;
            out[code] = 1;
        }
    }
    out[at++] = 0;
    return at;
}

size_t wire_decode(uint8_t *frame, size_t n)
{
    size_t from = 0, to = 0;
    while (from < n) {
        uint8_t code = frame[from++];
        if (code == 0 || from + code - 1 > n)
            return 0;
        for (uint8_t i = 1; i < code; i++)
            frame[to++] = frame[from++];
        if (code < 0xff && from < n)
            frame[to++] = 0;
    }
    if (to < sizeof(header_t) + 4)
        return 0;
    to -= 4;
    uint32_t crc;
    memcpy(&crc, frame + to, 4);
    return crc == crc32(frame, to) ? to : 0;
}
