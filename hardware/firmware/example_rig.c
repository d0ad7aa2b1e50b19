/* A rig's firmware: a board with an ADC, and switches that ground electrodes: one in
 * a slot, or those of a row of the host's table.
 *
 * One loop and nothing that waits. For a board write board.h's functions; for a computer
 * there is board_host.c:
 *
 *     cc -std=c99 example_rig.c tomojax_rig.c board_host.c -o rig
 */
#include <string.h>

#include "board.h"
#include "tomojax_rig.h"

#define SLOT_CODED TOMOJAX_CODED_SIZE(TOMOJAX_SLOT_SIZE(ELECTRODES))
/* Some slots and no more: what waits for the line is old when it is sent. */
#define RING (4u * SLOT_CODED + TOMOJAX_CODED_SIZE(TOMOJAX_DESCRIPTION_SIZE))
#define MOST (CONDITIONS > ELECTRODES ? CONDITIONS : ELECTRODES)
#define LINE (TOMOJAX_ROW_SIZE(ELECTRODES) + TOMOJAX_COMMAND_SIZE(MOST))

static uint8_t ring[RING];
static size_t head, waiting; /* first byte that waits, and how many do */

static uint8_t grounds[MOST];
static uint16_t count = 1, turn;
static uint8_t closed[CONDITIONS][ELECTRODES]; /* what each row of the table grounds */
static uint16_t rows, held;                     /* 0 rows: an electrode a slot */
static uint32_t table;
static uint32_t session, sequence;
static int running;
static tomojax_decoder line;

/* Puts a whole message on its way, or none of it: returns whether there was room. */
static int send(const uint8_t *message, size_t size)
{
    static uint8_t coded[SLOT_CODED + TOMOJAX_CODED_SIZE(TOMOJAX_DESCRIPTION_SIZE)];
    size_t length = tomojax_coded(coded, message, size);
    if (length > RING - waiting)
        return 0;
    for (size_t k = 0; k < length; k++)
        ring[(head + waiting + k) % RING] = coded[k];
    waiting += length;
    return 1;
}

static void transmit(void)
{
    size_t piece = waiting < RING - head ? waiting : RING - head;
    if (piece == 0)
        return;
    size_t sent = uart_write_some(ring + head, piece);
    head = (head + sent) % RING;
    waiting -= sent;
}

static void describe(void)
{
    /* 1e6 / SLOT_MICROSECONDS slots a second, 2^-13 V per code, no offset. */
    uint16_t version = rows == 0 ? TOMOJAX_VERSION : TOMOJAX_TABLES;
    tomojax_told told = {ELECTRODES, session, sequence, 0, 0, 0, version, held, table};
    uint8_t message[TOMOJAX_DESCRIPTION_SIZE];
    told.rate = tomojax_bits(1e6 / SLOT_MICROSECONDS);
    told.scale = tomojax_bits(1.0 / 8192);
    /* No slot goes before it; where there is no room the host asks again. */
    if (send(message, tomojax_description(message, &told)))
        running = held == rows;
}

/* Takes the row that is due: its switches, as the board's paths have one resistance. */
static void take(const tomojax_command *told)
{
    if (told->rows != rows || told->table != table) {
        rows = told->rows; /* another table, or none */
        table = told->table;
        held = turn = 0;
        count = 1;
        grounds[0] = 0;
    }
    if (held >= rows || held >= CONDITIONS || told->row != held)
        return;
    for (uint16_t k = 0; k < ELECTRODES; k++)
        closed[held][k] = (tomojax_conductance(told, k) & 0x7FFFFFFFu) != 0;
    held++;
}

/* Takes every byte that is there: of several GROUNDS the newest stays. */
static void obey(void)
{
    int byte;
    while ((byte = uart_read()) >= 0) {
        size_t size = tomojax_decode(&line, (uint8_t)byte);
        if (size == 0)
            continue;
        tomojax_command told = tomojax_command_of(line.buffer, size, ELECTRODES,
                                                  rows == 0 ? ELECTRODES : rows);
        if (told.kind == TOMOJAX_START) {
            take(&told);
            describe();
        } else if (told.kind == TOMOJAX_STOP) {
            running = 0;
        } else if (told.kind == TOMOJAX_GROUNDS && told.count <= MOST) {
            memcpy(grounds, told.grounds, told.count);
            count = told.count;
            turn = 0;
        }
    }
}

static const uint8_t *switches(uint8_t ground)
{
    static uint8_t alone[ELECTRODES];
    if (rows != 0)
        return closed[ground];
    memset(alone, 0, sizeof alone);
    alone[ground] = 1;
    return alone;
}

static void wait_until(uint64_t moment)
{
    while (micros() < moment) {
        transmit();
        board_idle();
    }
}

static void slot(void)
{
    static int16_t codes[ELECTRODES];
    static uint8_t message[TOMOJAX_SLOT_SIZE(ELECTRODES)];
    uint8_t ground = grounds[turn];
    turn = (uint16_t)((turn + 1) % count);
    mux_ground(switches(ground));
    wait_until(micros() + SETTLE_MICROSECONDS);
    for (uint16_t k = 0; k < ELECTRODES; k++)
        codes[k] = adc_read(k);
    uint64_t now = micros();
    /* Without room the slot is dropped; its number is used up all the same. */
    send(message, tomojax_slot(message, ground, sequence, now, codes, ELECTRODES));
}

int main(void)
{
    static uint8_t buffer[LINE];
    board_begin();
    session = board_session();
    tomojax_decoder_begin(&line, buffer, sizeof buffer);
    uint64_t due = micros();
    for (;;) {
        wait_until(due);
        obey();
        if (running)
            slot();
        transmit();
        /* Periods that went by meanwhile have numbers too: the host sees the gap. */
        do {
            sequence++;
            due += SLOT_MICROSECONDS;
        } while (micros() >= due + SLOT_MICROSECONDS);
    }
}
