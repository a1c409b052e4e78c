/* One board under simavr, in step with a caller: a process of its own, since simavr is GPL-3.
 *
 *   simhost board.elf BOARD [NUMBER OF THE ARM]
 *
 * Standard input takes requests, standard output answers each of them. Little-endian, packed.
 *
 * | request | |
 * |---|---|
 * | 'S', u32 cycles, line, readings | runs so many cycles of the 16 MHz clock |
 * | 'P' | power off and on: the SRAM comes up as noise |
 * | 'R' | reset: the SRAM stays as it is |
 * | 'J' | an IMU loses count in the middle of a byte: it holds the data line until it was clocked nine times |
 *
 * line: u16 n, n bytes for the board. They are put on its line one after the other, 20 us each.
 * readings: 6 x (u16 count, u16 gate ticks); 2 x (u8 answers, 14 register bytes); 3 x u16 gauge, mV;
 * u8 whether the emergency stop's contact is open.
 * answer: u64 cycle of the pump enable's last edge, u8 pumps, u8 gripper closed, u8 supply, 3 x u16 duty,
 * u8 runs, u16 n, n bytes from the board.
 *
 * A firmware that writes its EEPROM, which wears out, is ended.
 */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "avr_adc.h"
#include "avr_eeprom.h"
#include "avr_ioport.h"
#include "avr_spi.h"
#include "avr_twi.h"
#include "avr_uart.h"
#include "sim_avr.h"
#include "sim_elf.h"
#include "sim_time.h"

#define BYTE_BITS 10 /* 8N1 */
#define BYTE_US 20   /* at 500 kbaud */
#define IMU_ADDRESS 0x68
#define IMU_REGISTERS 128
#define IMU_DATA 0x3b
#define IMU_DATA_N 14
/* Data addresses of the ATmega2560. */
#define OCR4A_ADDRESS 0xa8
#define UCSR0A_ADDRESS 0xc0
#define U2X0_BIT 0x02
#define UBRR0L_ADDRESS 0xc4
#define EECR_ADDRESS 0x3f
#define EEPE_BIT 0x02

typedef struct {
    uint8_t address; /* 7 bit */
    bool answers, selected, addressed;
    uint8_t at;
    uint8_t reg[IMU_REGISTERS];
    avr_irq_t *to_avr;
} imu_t;

static avr_t *avr;
static int board_id;

static uint8_t inbox[1 << 16];
static uint16_t inbox_n, inbox_at;
static uint8_t outbox[1 << 16];
static uint32_t outbox_n;
static avr_irq_t *uart_in;
static avr_uart_t *uart;

static uint8_t counters[24];
static uint8_t counters_at;
static avr_irq_t *spi_in;

static imu_t imu[2];
/* Clocks that an IMU still wants before it lets go of the data line. */
static int bus_held_for;
static avr_irq_t *scl, *sda;
static uint16_t gauge_mv[3];
static avr_irq_t *adc_in;

/* What a gauge's cable picks up, mV at most either way; the ADC's averages live on it. */
#define HUM_MV 6
static uint32_t hum_state = 1;
static uint32_t sram_state;

static avr_cycle_count_t pump_edge;
static bool pumps, gripper, supply;
static uint8_t stop_open;

/* ---- what the firmware does to its pins ---------------------------------------------------------- */

static void on_uart(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)param;
    if (outbox_n < sizeof outbox)
        outbox[outbox_n++] = (uint8_t)value;
}

static void on_pumps(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)param;
    if (pumps != (value != 0))
        pump_edge = avr->cycle;
    pumps = value != 0;
}

/* The gripper's valve stays where its last pulse sent it. */
static void on_gripper(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    if (value)
        gripper = param != NULL;
}

static void on_supply(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)param;
    supply = value != 0;
}

static void on_select(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)param;
    if (!value)
        counters_at = 0;
}

static void on_spi(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)value, (void)param;
    avr_raise_irq(spi_in, counters_at < sizeof counters ? counters[counters_at++] : 0);
}

/* An IMU with the registers of an MPU-6050: asleep until woken, then its data registers are live. */
static void on_twi(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    imu_t *m = param;
    avr_twi_msg_irq_t v = {.u.v = value};
    if (v.u.twi.msg & TWI_COND_STOP)
        m->selected = false;
    if (v.u.twi.msg & TWI_COND_START) {
        m->selected = m->answers && !bus_held_for && (v.u.twi.addr >> 1) == m->address;
        if (m->selected) {
            m->addressed = v.u.twi.addr & 1;
            avr_raise_irq(m->to_avr, avr_twi_irq_msg(TWI_COND_ACK, v.u.twi.addr, 1));
        }
    }
    if (!m->selected)
        return;
    if (v.u.twi.msg & TWI_COND_WRITE) {
        avr_raise_irq(m->to_avr, avr_twi_irq_msg(TWI_COND_ACK, v.u.twi.addr, 1));
        if (!m->addressed) {
            m->at = v.u.twi.data;
            m->addressed = true;
        } else {
            m->reg[m->at++ % IMU_REGISTERS] = v.u.twi.data;
        }
    }
    if (v.u.twi.msg & TWI_COND_READ) {
        const bool data = m->at >= IMU_DATA && m->at < IMU_DATA + IMU_DATA_N;
        const bool asleep = m->reg[0x6b] & 0x40;
        const uint8_t byte = data && asleep ? 0 : m->reg[m->at % IMU_REGISTERS];
        m->at++;
        avr_raise_irq(m->to_avr, avr_twi_irq_msg(TWI_COND_READ, v.u.twi.addr, byte));
    }
}

/* simavr counts a parity bit whatever the frame's format is: the line's own time is put in its place. */
static void on_baud(avr_t *a, avr_io_addr_t addr, uint8_t value, void *param)
{
    (void)addr, (void)param;
    const int cycles_per_bit = (value + 1) * (a->data[UCSR0A_ADDRESS] & U2X0_BIT ? 8 : 16);
    uart->cycles_per_byte = (avr_cycle_count_t)(BYTE_BITS * cycles_per_bit);
}

static void on_eeprom(avr_t *a, avr_io_addr_t addr, uint8_t value, void *param)
{
    (void)a, (void)addr, (void)param;
    if (value & EEPE_BIT) {
        fprintf(stderr, "the firmware writes its EEPROM, which wears out\n");
        exit(3);
    }
}

/* The levels of the two-wire bus, high by its resistors unless an IMU holds the data. */
static void set_bus(void)
{
    avr_ioport_external_t bus = {.name = 'D', .mask = 3, .value = bus_held_for ? 1 : 3};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &bus);
    avr_raise_irq(scl, 1);
    avr_raise_irq(sda, !bus_held_for);
}

/* The firmware moves the bus by the direction of its pins: a clock is one low and high again. */
static void on_bus_direction(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)param;
    const bool released = (irq->value & 1) && !(value & 1);
    if (bus_held_for && released && --bus_held_for == 0)
        set_bus();
}

/* ---- what the world does to the board -------------------------------------------------------------- */

static avr_cycle_count_t feed(avr_t *a, avr_cycle_count_t when, void *param)
{
    (void)param;
    if (inbox_at < inbox_n)
        avr_raise_irq(uart_in, inbox[inbox_at++]);
    return when + avr_usec_to_cycles(a, BYTE_US);
}

/* A conversion begins: the gauges' voltages as they are just then. */
static void on_conversion(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)value, (void)param;
    for (int i = 0; i < 3; i++) {
        int hum = 0;
        for (int k = 0; k < 2; k++) {
            hum_state = hum_state * 1664525u + 1013904223u;
            hum += (int)(hum_state >> 24) % (HUM_MV + 1) - HUM_MV / 2;
        }
        /* A gauge at its rail or without a cable hums no more. */
        const bool dead = gauge_mv[i] < 200 || gauge_mv[i] > 4800;
        const int mv = gauge_mv[i] + (dead ? 0 : hum);
        /* The chip rounds mV * 1024 / 5000, simavr cuts mV * 1023 / 5000: give it what it makes the
         * chip's number of. */
        int code = (mv * 1024 + 2500) / 5000;
        code = code > 1023 ? 1023 : code;
        avr_raise_irq(adc_in + i, (uint32_t)((code * 5000 + 1022) / 1023));
    }
}

static void world(void)
{
    for (int i = 0; i < 2; i++) {
        avr_irq_t *twi_out = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_OUTPUT);
        imu[i].address = (uint8_t)(IMU_ADDRESS + i);
        imu[i].to_avr = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_INPUT);
        avr_irq_register_notify(twi_out, on_twi, &imu[i]);
    }
    uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    for (avr_io_t *io = avr->io_port; io && !uart; io = io->next)
        if (!strcmp(io->kind, "uart") && ((avr_uart_t *)io)->name == '0')
            uart = (avr_uart_t *)io;
    avr_register_io_write(avr, UBRR0L_ADDRESS, on_baud, NULL);
    avr_register_io_write(avr, EECR_ADDRESS, on_eeprom, NULL);
    scl = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), IOPORT_IRQ_PIN0);
    sda = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), IOPORT_IRQ_PIN1);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), IOPORT_IRQ_DIRECTION_ALL),
                            on_bus_direction, NULL);
    spi_in = avr_io_getirq(avr, AVR_IOCTL_SPI_GETIRQ(0), SPI_IRQ_INPUT);
    adc_in = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_uart, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_SPI_GETIRQ(0), SPI_IRQ_OUTPUT), on_spi, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('A'), 0), on_pumps, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('A'), 1), on_gripper, &gripper);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('A'), 2), on_gripper, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('A'), 3), on_supply, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 0), on_select, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), on_conversion, NULL);
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
}

static void (*core_reset)(avr_t *);
static bool was_reset;

/* A reset from within, by the watchdog. */
static void on_reset(avr_t *a)
{
    if (core_reset)
        core_reset(a);
    was_reset = true;
}

/* The straps (which board, and that the arm is simulated) and the emergency stop's contact. */
static void set_inputs(void)
{
    const uint8_t levels = (uint8_t)((board_id == 0) | stop_open << 2);
    avr_ioport_external_t inputs = {.name = 'L', .mask = 7, .value = levels};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('L'), &inputs);
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('L'), 2), stop_open);
}

/* Sets what any reset of the simulated chip forgets of the world around it: straps and line. */
static void wire_up(void)
{
    /* The chip let go of its pins; simavr keeps their last levels and tells changes only. */
    for (int pin = 0; pin < 4; pin++)
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('A'), pin), 0);
    for (int pin = 0; pin < 3; pin++)
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('L'), pin), 0);
    set_inputs();
    set_bus();
    avr_cycle_timer_register_usec(avr, BYTE_US, feed, NULL);
    was_reset = false;
}

/* After a reset nothing of the line before it is heard. */
static void start_over(void)
{
    inbox_n = inbox_at = 0;
    wire_up();
}

/* Power has come: the SRAM holds noise, the IMUs sleep. */
static void power_up(void)
{
    for (int i = 0; i < 2; i++) {
        memset(imu[i].reg, 0, sizeof imu[i].reg);
        imu[i].reg[0x6b] = 0x40;
    }
    for (uint32_t at = avr->ioend + 1u; at <= avr->ramend; at++) {
        sram_state = sram_state * 1664525u + 1013904223u;
        avr->data[at] = (uint8_t)(sram_state >> 24);
    }
    bus_held_for = 0;
    start_over();
}

/* The caller keeps the time: sleeping costs none. */
static void sleep_no_time(avr_t *a, avr_cycle_count_t cycles)
{
    (void)a, (void)cycles;
}

/* ---- the caller ------------------------------------------------------------------------------------ */

static bool take(void *to, size_t n)
{
    return fread(to, 1, n, stdin) == n;
}

static FILE *answers;

static void give(const void *from, size_t n)
{
    fwrite(from, 1, n, answers);
}

static bool take_readings(void)
{
    uint16_t n;
    if (!take(&n, 2))
        return false;
    if (inbox_at == inbox_n)
        inbox_at = inbox_n = 0;
    if (inbox_n + n > (int)sizeof inbox / 2)
        inbox_n = inbox_at = 0; /* nobody sends so much faster than the line: it is lost */
    if (!take(inbox + inbox_n, n))
        return false;
    inbox_n = (uint16_t)(inbox_n + n);
    if (!take(counters, sizeof counters))
        return false;
    for (int i = 0; i < 2; i++) {
        uint8_t answers;
        if (!take(&answers, 1) || !take(imu[i].reg + IMU_DATA, IMU_DATA_N))
            return false;
        imu[i].answers = answers;
    }
    const uint8_t was_open = stop_open;
    if (!take(gauge_mv, sizeof gauge_mv) || !take(&stop_open, 1))
        return false;
    if (stop_open != was_open)
        set_inputs();
    return true;
}

static void answer(bool runs)
{
    const uint64_t edge = pump_edge;
    const uint8_t state[3] = {pumps, gripper, supply};
    const uint8_t alive = runs;
    uint16_t n = (uint16_t)(outbox_n > 0xffff ? 0xffff : outbox_n);
    give(&edge, 8);
    give(state, sizeof state);
    give(avr->data + OCR4A_ADDRESS, 6);
    give(&alive, 1);
    give(&n, 2);
    give(outbox, n);
    outbox_n = 0;
    fflush(answers);
}

int main(int argc, char **argv)
{
    elf_firmware_t firmware = {0};
    /* The simulator prints on standard output: what it says must not get among the answers. */
    answers = fdopen(dup(STDOUT_FILENO), "wb");
    if (!answers || !freopen("/dev/null", "w", stdout))
        return 2;
    if (argc < 3 || argc > 4 || elf_read_firmware(argv[1], &firmware) != 0) {
        fprintf(stderr, "usage: simhost board.elf 0|1 [number of the arm]\n");
        return 2;
    }
    board_id = atoi(argv[2]);
    avr = avr_make_mcu_by_name("atmega2560");
    if (!avr) {
        fprintf(stderr, "this simavr does not know the ATmega2560\n");
        return 2;
    }
    avr_init(avr);
    avr->frequency = 16000000;
    avr->vcc = avr->avcc = avr->aref = 5000;
    avr->log = 1;
    avr_load_firmware(avr, &firmware);
    avr->frequency = 16000000;
    avr->sleep = sleep_no_time;
    core_reset = avr->reset;
    avr->reset = on_reset;
    if (argc == 4) {
        uint32_t number = (uint32_t)strtoul(argv[3], NULL, 0);
        avr_eeprom_desc_t eeprom = {.ee = (uint8_t *)&number, .offset = 0, .size = sizeof number};
        avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &eeprom);
    }
    world();
    power_up();

    avr_cycle_count_t until = avr->cycle;
    char request;
    while (take(&request, 1)) {
        bool runs = true;
        if (request == 'P') {
            avr_reset(avr);
            power_up();
        } else if (request == 'R') {
            avr_reset(avr);
            start_over();
        } else if (request == 'J') {
            bus_held_for = 9;
            set_bus();
        } else if (request == 'S') {
            uint32_t cycles;
            if (!take(&cycles, 4) || !take_readings())
                break;
            /* A sleeping chip wakes a little later: the next step is the shorter for it. */
            until += cycles;
            while (runs && avr->cycle < until) {
                const int state = avr_run(avr);
                if (was_reset)
                    wire_up();
                runs = state != cpu_Done && state != cpu_Crashed;
            }
        } else {
            fprintf(stderr, "no such request: %d\n", request);
            return 2;
        }
        answer(runs);
    }
    return 0;
}
