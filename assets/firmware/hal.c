#include "hal.h"

#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <string.h>
#include <util/atomic.h>
#include <util/delay.h>
#include <util/twi.h>

/* The compiler moves no access to memory across it. The chip itself keeps their order. */
#define BARRIER() __asm__ volatile("" ::: "memory")

/* ---- watchdog ---------------------------------------------------------------------------- */

/* After a watchdog reset the dog is still awake with its shortest leash: call it off before main. */
void early(void) __attribute__((naked, used, section(".init3")));
void early(void)
{
    MCUSR = 0;
    wdt_disable();
}

/* ---- clock: timer 1 at 2 MHz --------------------------------------------------------------- */

static volatile uint16_t overflows;

ISR(TIMER1_OVF_vect)
{
    overflows++;
}

/* With interrupts off. */
static uint32_t ticks(void)
{
    uint16_t low = TCNT1;
    uint16_t high = overflows;
    /* An overflow that has not been counted yet belongs to a low count read after it. */
    if ((TIFR1 & _BV(TOV1)) && low < 0x8000)
        high++;
    return (uint32_t)high << 16 | low;
}

uint32_t hal_ticks(void)
{
    uint32_t t;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { t = ticks(); }
    return t;
}

/* ---- serial line: 500 kbaud, USART 0 -------------------------------------------------------- */

#define SLOTS 8
static host_frame_t slot[SLOTS];
static volatile uint8_t slot_in, slot_out;
static volatile uint8_t fill;
static volatile bool overlong;

ISR(USART0_RX_vect)
{
    uint8_t byte = UDR0;
    host_frame_t *f = &slot[slot_in];
    if (byte != 0) {
        if (fill < HOST_FRAME_MAX)
            f->bytes[fill++] = byte;
        else
            overlong = true;
        return;
    }
    uint8_t next = (slot_in + 1) % SLOTS;
    if (fill && !overlong && next != slot_out) {
        f->n = fill;
        f->t_ticks = ticks();
        BARRIER(); /* the frame is whole before it is seen */
        slot_in = next;
    }
    fill = 0;
    overlong = false;
}

bool hal_receive(host_frame_t *frame)
{
    if (slot_out == slot_in)
        return false;
    BARRIER(); /* no byte of the frame is read before it is known to be whole, */
    *frame = slot[slot_out];
    BARRIER(); /* nor after its slot is free for another */
    slot_out = (slot_out + 1) % SLOTS;
    return true;
}

#define OUTBOX 512 /* a power of two */
#define BYTE_TICKS (10 * TICK_RATE_HZ / BAUD) /* 8N1: start, 8 bits, stop */
static uint8_t outbox[OUTBOX];
static volatile uint16_t out_head, out_tail;

ISR(USART0_UDRE_vect)
{
    if (out_head == out_tail) {
        UCSR0B &= ~_BV(UDRIE0);
        return;
    }
    UDR0 = outbox[out_tail];
    out_tail = (out_tail + 1) & (OUTBOX - 1);
}

bool hal_send(const uint8_t *bytes, size_t n)
{
    uint16_t head = out_head, tail;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { tail = out_tail; }
    uint16_t room = (uint16_t)(tail - head - 1) & (OUTBOX - 1);
    if (n > room)
        return false;
    while (n--) {
        outbox[head] = *bytes++;
        head = (head + 1) & (OUTBOX - 1);
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        out_head = head;
        UCSR0B |= _BV(UDRIE0);
    }
    return true;
}

uint32_t hal_send_ticks(void)
{
    uint32_t t;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        t = ticks() + (uint32_t)((out_head - out_tail) & (OUTBOX - 1)) * BYTE_TICKS;
    }
    return t;
}

static void serial_init(void)
{
    UCSR0A = _BV(U2X0); /* before the rate: some simulators compute it there */
    UBRR0 = F_CPU / 8 / BAUD - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

/* ---- gauges: ADC 0 .. 2, 0.5 .. 4.5 V over -50 .. 50 kPa -------------------------------------- */

#define CONVERSIONS 16
static volatile uint16_t sum[CHAMBERS_EACH];
static volatile bool sums_fresh;

static void adc_select(uint8_t channel)
{
    ADMUX = _BV(REFS0) | channel;
}

ISR(ADC_vect)
{
    static uint8_t channel, n;
    static uint16_t total;
    total += ADC;
    if (++n == CONVERSIONS) {
        sum[channel] = total;
        total = 0;
        n = 0;
        if (++channel == CHAMBERS_EACH) {
            channel = 0;
            sums_fresh = true;
        }
        adc_select(channel);
    }
    ADCSRA |= _BV(ADSC);
}

bool hal_gauges(uint16_t code[CHAMBERS_EACH], bool valid[CHAMBERS_EACH])
{
    uint16_t s[CHAMBERS_EACH];
    bool fresh;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        fresh = sums_fresh;
        sums_fresh = false;
        for (uint8_t i = 0; i < CHAMBERS_EACH; i++)
            s[i] = sum[i];
    }
    if (!fresh)
        return false;
    for (uint8_t i = 0; i < CHAMBERS_EACH; i++) {
        /* A sum of 16384 is 5 V; beyond 0.2 and 4.8 V the gauge is at its rail. */
        valid[i] = s[i] >= 655 && s[i] <= 15729;
        /* 25 Pa per mV, 2 Pa per count: count = sum * 5000 / 16384 * 12.5 - 2500 * 12.5 */
        code[i] = (uint16_t)((uint32_t)s[i] * 15625 / 4096 + 32768UL - 31250UL);
    }
    return true;
}

static void gauges_init(void)
{
    adc_select(0);
    DIDR0 = _BV(ADC0D) | _BV(ADC1D) | _BV(ADC2D);
    ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0) | _BV(ADSC);
}

/* ---- counters: six reciprocal counters behind SPI ------------------------------------------- */

#define COUNTERS_SELECT PB0

static uint8_t spi_read(void)
{
    SPDR = 0;
    loop_until_bit_is_set(SPSR, SPIF);
    return SPDR;
}

void hal_counters(counter_t counter[SPRINGS_EACH])
{
    uint8_t *b = (uint8_t *)counter;
    PORTB &= ~_BV(COUNTERS_SELECT); /* the falling edge latches all six */
    for (uint8_t i = 0; i < SPRINGS_EACH * sizeof *counter; i++)
        b[i] = spi_read();
    PORTB |= _BV(COUNTERS_SELECT);
}

static void counters_init(void)
{
    PORTB |= _BV(COUNTERS_SELECT);
    DDRB |= _BV(COUNTERS_SELECT) | _BV(PB1) | _BV(PB2);
    SPCR = _BV(SPE) | _BV(MSTR); /* 4 MHz */
}

/* ---- IMUs: two MPU-6050 on the two-wire bus, 400 kHz ---------------------------------------- */

#define IMU_ADDRESS 0x68
#define IMU_PATIENCE (3 * TICKS_PER_MS / 2)
/* An IMU that has not answered so often running is asked in every so manyth sample only: what waits for the bus checks
 * no gauge. */
#define IMU_FAILURES 3
#define IMU_SKIPS 3
#define SCL PD0
#define SDA PD1

static uint32_t twi_deadline;

static struct {
    uint8_t address;
    const uint8_t *out;
    uint8_t out_n;
    uint8_t *in;
    uint8_t in_n;
    volatile enum { TWI_RUNNING, TWI_DONE, TWI_FAILED } state;
} twi;

/* An IMU that lost count of the clock in the middle of a byte (a glitch, a reset of this chip) holds the data line, and
 * then no START comes through. It lets go within nine clocks, and a STOP ends what it was at. The pins are open
 * drains here: low by their direction, high by the bus. */
static void bus_free(void)
{
    TWCR = 0;
    PORTD &= ~(_BV(SCL) | _BV(SDA));
    for (uint8_t n = 0; n < 9 && bit_is_clear(PIND, SDA); n++) {
        DDRD |= _BV(SCL);
        _delay_us(5);
        DDRD &= ~_BV(SCL);
        _delay_us(5);
    }
    DDRD |= _BV(SCL);
    DDRD |= _BV(SDA);
    _delay_us(5);
    DDRD &= ~_BV(SCL);
    _delay_us(5);
    DDRD &= ~_BV(SDA);
    _delay_us(5);
}

static void twi_end(uint8_t state)
{
    twi.state = state;
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
}

/* Polling TWINT would do on the chip; the interrupt also does in a simulator. */
ISR(TWI_vect)
{
    const uint8_t go_on = _BV(TWINT) | _BV(TWEN) | _BV(TWIE);
    switch (TW_STATUS) {
    case TW_START:
        TWDR = (uint8_t)(twi.address << 1);
        TWCR = go_on;
        break;
    case TW_REP_START:
        TWDR = (uint8_t)(twi.address << 1) | 1;
        TWCR = go_on;
        break;
    case TW_MT_SLA_ACK:
    case TW_MT_DATA_ACK:
        if (twi.out_n) {
            twi.out_n--;
            TWDR = *twi.out++;
            TWCR = go_on;
        } else if (twi.in_n) {
            TWCR = go_on | _BV(TWSTA);
        } else {
            twi_end(TWI_DONE);
        }
        break;
    case TW_MR_SLA_ACK:
        TWCR = go_on | (twi.in_n > 1 ? _BV(TWEA) : 0);
        break;
    case TW_MR_DATA_ACK:
    case TW_MR_DATA_NACK:
        *twi.in++ = TWDR;
        if (--twi.in_n == 0)
            twi_end(TWI_DONE);
        else
            TWCR = go_on | (twi.in_n > 1 ? _BV(TWEA) : 0);
        break;
    default:
        twi_end(TWI_FAILED);
    }
}

static bool twi_exchange(uint8_t address, const uint8_t *out, uint8_t out_n, uint8_t *in, uint8_t in_n)
{
    twi.address = address;
    twi.out = out;
    twi.out_n = out_n;
    twi.in = in;
    twi.in_n = in_n;
    twi.state = TWI_RUNNING;
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWIE) | _BV(TWSTA);
    while (twi.state == TWI_RUNNING) {
        if ((int32_t)(hal_ticks() - twi_deadline) > 0) {
            TWCR = 0; /* a stuck bus: let go of it */
            return false;
        }
        hal_wait();
    }
    BARRIER(); /* what was read is read after the end is known */
    return twi.state == TWI_DONE;
}

static bool imu_register(uint8_t address, uint8_t reg, uint8_t value)
{
    const uint8_t out[2] = {reg, value};
    return twi_exchange(address, out, 2, NULL, 0);
}

bool hal_imu(uint8_t which, int16_t gyro[3], int16_t accel[3])
{
    static bool awake[IMUS_EACH];
    static uint8_t failures[IMUS_EACH], skips[IMUS_EACH];
    const uint8_t address = IMU_ADDRESS + which;
    if (skips[which]) {
        skips[which]--;
        return false;
    }
    twi_deadline = hal_ticks() + IMU_PATIENCE;
    if (!awake[which]) {
        /* out of sleep; +-500 deg/s; +-4 g; low pass 94 Hz */
        awake[which] = imu_register(address, 0x6b, 0x01) && imu_register(address, 0x1b, 0x08) &&
                       imu_register(address, 0x1c, 0x08) && imu_register(address, 0x1a, 0x02);
    }
    uint8_t b[14];
    const uint8_t first = 0x3b;
    if (!awake[which] || !twi_exchange(address, &first, 1, b, sizeof b)) {
        awake[which] = false;
        if (bit_is_clear(PIND, SDA))
            bus_free();
        if (failures[which] < IMU_FAILURES)
            failures[which]++;
        else
            skips[which] = IMU_SKIPS;
        return false;
    }
    failures[which] = 0;
    for (uint8_t k = 0; k < 3; k++) {
        accel[k] = (int16_t)((uint16_t)b[2 * k] << 8 | b[2 * k + 1]);
        gyro[k] = (int16_t)((uint16_t)b[8 + 2 * k] << 8 | b[9 + 2 * k]);
    }
    return true;
}

static void imus_init(void)
{
    if (bit_is_clear(PIND, SDA))
        bus_free();
    TWSR = 0;
    TWBR = (F_CPU / 400000UL - 16) / 2;
}

/* ---- pumps, supply, emergency stop, gripper --------------------------------------------------- */

#define PUMPS_ENABLE PA0
#define GRIPPER_CLOSE PA1
#define GRIPPER_OPEN PA2
#define SUPPLY_OPEN PA3
#define STOP_CONTACT PL2
#define GRIPPER_PULSE (100 * TICKS_PER_MS)
#define PWM_TOP 8000
#define PWM_ZERO (PWM_TOP / 2)

/* Duty of a pressure: the regulators take 0 .. 100 % for -50 .. 50 kPa. A gauge reads further than that. */
static uint16_t duty(uint16_t code)
{
    /* 2 Pa per count over 12.5 Pa per step: 4 / 25 */
    int32_t steps = ((int32_t)code - 32768) * 4;
    steps += steps < 0 ? -12 : 12;
    const int32_t d = PWM_ZERO + steps / 25;
    return d < 0 ? 0 : d > PWM_TOP ? PWM_TOP : (uint16_t)d;
}

void hal_regulators(const uint16_t code[CHAMBERS_EACH])
{
    const uint16_t d[CHAMBERS_EACH] = {duty(code[0]), duty(code[1]), duty(code[2])};
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        OCR4A = d[0];
        OCR4B = d[1];
        OCR4C = d[2];
    }
}

static void put(uint8_t pin, bool high)
{
    if (high)
        PORTA |= _BV(pin);
    else
        PORTA &= ~_BV(pin);
}

void hal_pumps(bool on)
{
    put(PUMPS_ENABLE, on);
}

#define SUPPLY_IS_CUT 0x3cc3
/* Survives every reset but the loss of power, after which it holds noise. */
static uint16_t supply __attribute__((section(".noinit")));

void hal_supply(bool open)
{
    supply = open ? 0 : SUPPLY_IS_CUT;
    put(SUPPLY_OPEN, open);
}

bool hal_supply_cut(void)
{
    return supply == SUPPLY_IS_CUT;
}

/* The contact pulls the pin low; a cut wire reads as an open contact. */
bool hal_stop_open(void)
{
    return PINL & _BV(STOP_CONTACT);
}

#define GRIPPER_IS_OPEN 0x5a0f
#define GRIPPER_IS_CLOSED 0xa5f0
/* Survives every reset but the loss of power, after which it holds noise. */
static uint16_t gripper __attribute__((section(".noinit")));
/* What the pulse under way sends it to; 0: none is. A pulse that a reset cuts short has not moved it for certain. */
static uint16_t gripper_next;
static uint32_t gripper_from;

static uint16_t gripper_now(void)
{
    return gripper_next ? gripper_next : gripper;
}

void hal_gripper(bool closed)
{
    const uint16_t wanted = closed ? GRIPPER_IS_CLOSED : GRIPPER_IS_OPEN;
    if (gripper_now() == wanted)
        return;
    gripper_next = wanted;
    gripper = 0;
    put(closed ? GRIPPER_OPEN : GRIPPER_CLOSE, false);
    put(closed ? GRIPPER_CLOSE : GRIPPER_OPEN, true);
    gripper_from = hal_ticks();
}

bool hal_gripper_closed(void)
{
    return gripper_now() == GRIPPER_IS_CLOSED;
}

bool hal_gripper_known(void)
{
    return gripper_now() == GRIPPER_IS_CLOSED || gripper_now() == GRIPPER_IS_OPEN;
}

void hal_gripper_tick(void)
{
    if (gripper_next && hal_ticks() - gripper_from > GRIPPER_PULSE) {
        gripper = gripper_next;
        gripper_next = 0;
        put(GRIPPER_OPEN, false);
        put(GRIPPER_CLOSE, false);
    }
}

static void pumps_init(void)
{
    static const uint16_t zero[CHAMBERS_EACH] = {32768U, 32768U, 32768U};
    PORTA &= ~(_BV(PUMPS_ENABLE) | _BV(GRIPPER_CLOSE) | _BV(GRIPPER_OPEN));
    DDRA |= _BV(PUMPS_ENABLE) | _BV(GRIPPER_CLOSE) | _BV(GRIPPER_OPEN) | _BV(SUPPLY_OPEN);
    ICR4 = PWM_TOP; /* fast PWM, 2 kHz */
    TCCR4A = _BV(COM4A1) | _BV(COM4B1) | _BV(COM4C1) | _BV(WGM41);
    TCCR4B = _BV(WGM43) | _BV(WGM42) | _BV(CS40);
    hal_regulators(zero);
    DDRH |= _BV(PH3) | _BV(PH4) | _BV(PH5);
}

/* ---- the rest --------------------------------------------------------------------------------- */

uint8_t hal_board(void)
{
    return (PINL & _BV(PL0)) ? 0 : 1;
}

bool hal_simulated(void)
{
    return !(PINL & _BV(PL1));
}

uint32_t hal_rig(void)
{
    return eeprom_read_dword((const uint32_t *)0);
}

/* Survives every reset but the loss of power; after that, its cells come up as noise. */
static struct {
    uint32_t boots;
    uint8_t cells[128];
} kept __attribute__((section(".noinit")));

uint32_t hal_boot_nonce(uint8_t board)
{
    kept.boots++;
    const uint32_t nonce = crc32(&kept, sizeof kept);
    /* Two boards never share one, not even if their cells came up alike. */
    return (nonce & ~1UL) | board;
}

void hal_wait(void)
{
    set_sleep_mode(SLEEP_MODE_IDLE);
    sleep_mode();
}

void hal_init(void)
{
    pumps_init(); /* first: off */
    PORTL |= _BV(PL0) | _BV(PL1) | _BV(STOP_CONTACT);
    TCCR1B = _BV(CS11); /* 16 MHz / 8 */
    TIMSK1 = _BV(TOIE1);
    serial_init();
    gauges_init();
    counters_init();
    imus_init();
    sei();
}
