/* The board's hardware: clock, serial line, gauges, counters, IMUs, pumps, gripper. README.md has the pins. */
#ifndef HAL_H
#define HAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "wire.h"

#define TICKS_PER_MS (TICK_RATE_HZ / 1000)

#define SPRINGS_EACH 6
#define IMUS_EACH 2
#define CHAMBERS_EACH 3
_Static_assert(sizeof ((sample_t *)0)->spring_counts == 2 * 2 * SPRINGS_EACH, "two boards share the springs");
_Static_assert(sizeof ((sample_t *)0)->gyro == 2 * 2 * 3 * IMUS_EACH, "two boards share the IMUs");
_Static_assert(sizeof ((sample_t *)0)->pressure == 2 * 2 * CHAMBERS_EACH, "two boards share the chambers");

/* A frame from the host as it came in. */
typedef struct {
    uint8_t bytes[HOST_FRAME_MAX];
    uint8_t n;
    uint32_t t_ticks; /* when its last byte was there */
} host_frame_t;

typedef struct {
    uint16_t count, gate_ticks;
} counter_t;

void hal_init(void);

/* 0 or 1, by a strap. */
uint8_t hal_board(void);

/* Whether a simulated arm is at the connectors, by another strap. */
bool hal_simulated(void);

/* Number of the arm, from bytes 0 to 3 of the EEPROM; all ones if none was written. */
uint32_t hal_rig(void);

/* Differs from one boot to the next. Writes nothing that wears out. */
uint32_t hal_boot_nonce(uint8_t board);

/* 0.5 us each, wraps every 35.8 minutes. */
uint32_t hal_ticks(void);

/* Takes the oldest frame from the host, if there is one. */
bool hal_receive(host_frame_t *frame);

/* When a frame queued now begins to go out: behind what waits already, 20 us a byte. */
uint32_t hal_send_ticks(void);

/* Queues bytes for the host, all or none. */
bool hal_send(const uint8_t *bytes, size_t n);

/* Takes new gauge readings, about every 5 ms: codes of 2 Pa from 32768. A gauge at its rail is not valid. */
bool hal_gauges(uint16_t code[CHAMBERS_EACH], bool valid[CHAMBERS_EACH]);

/* Latches and reads the six reciprocal counters; a counter without a signal reads zeros. */
void hal_counters(counter_t counter[SPRINGS_EACH]);

/* Reads an IMU; false if it does not answer. At most 3 ms, usually 0.5 ms. A bus that an IMU holds is freed for the
 * next reading. */
bool hal_imu(uint8_t which, int16_t gyro[3], int16_t accel[3]);

/* Sets the regulators to these pressures (codes), whether they are enabled or not. */
void hal_regulators(const uint16_t code[CHAMBERS_EACH]);

/* Enables the regulators, or cuts them off. */
void hal_pumps(bool on);

/* Opens or cuts the valve of the supply. */
void hal_supply(bool open);

/* Whether it was cut and not opened again since the power came. */
bool hal_supply_cut(void);

/* Whether the emergency stop's contact is open. */
bool hal_stop_open(void);

/* Sends the gripper's valve, which stays where it is without current, to one of its ends. */
void hal_gripper(bool closed);

/* What is known of the gripper: it outlives every reset but the loss of power. */
bool hal_gripper_known(void);
bool hal_gripper_closed(void);

/* Ends the gripper's pulse in time. To be called every few milliseconds. */
void hal_gripper_tick(void);

/* Sleeps until the next interrupt. */
void hal_wait(void);

#endif
