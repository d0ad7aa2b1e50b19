/* The live loop's ordinary way: slots from a wire into a step in C, and grounds back.
 *
 * What is not ordinary goes back to Python, with the bytes that were not worked on: a piece
 * that is no sound slot, a number that jumped, a clock that fell, a silent or cut line. So
 * Python's source says what each of those means, and nothing here does.
 *
 * REAL is the step's number. Compiled beside hardware/firmware/tomojax_rig.c.
 */
#include <errno.h>
#include <math.h>
#include <poll.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>
#include "tomojax_rig.c"

enum { TIME_IS_UP, NOT_ORDINARY };
enum { HEAD = 16, TOLD = 40 }; /* bytes of a slot before its codes, of a description */

typedef void step_fn(const void *, const REAL *, const int32_t *, const REAL *,
                     const int32_t *, int64_t, REAL *, int32_t *, REAL *, int32_t *);

/* Where a ring's fields are in a row, bytes from its start. */
typedef struct {
    int32_t number, lost, time, latency, ground, next, flags, count, xy, conductance, codes;
} fields;

/* As in _in_c.py, which fills it. */
typedef struct {
    /* The step, its state and what it says. */
    step_fn *step;
    const void *tables;
    REAL *numbers, *said;
    int32_t *whole, *said_whole;
    /* The ring. */
    char *rows;
    int64_t length, row_bytes, *written, *latencies, longest;
    const float *trim;
    fields at;
    /* The rig: which channel each electrode has, and which electrode each ground. */
    int32_t electrodes, conditions, contacts, serial, descriptor, trusted;
    const int32_t *channels, *electrode_of, *line_of;
    float scale, offset;
    double period, hurry, usual;
    /* Bytes that came: those from `first` to `end` are not worked on yet. */
    uint8_t *bytes;
    int64_t room, first, end;
    double arrived;
    /* Where the wire is. */
    uint32_t next;
    int64_t number, last, origin, slots, lost;
    double base;
    /* Where the loop is. */
    int64_t missed, skipped;
    int32_t asked, unheeded, again, ground;
} loop;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Datagrams lie one after the other, each behind two bytes with its length. */
static int read_datagrams(loop *L)
{
    const int64_t most = HEAD + TOLD + 2 * (int64_t)L->electrodes;
    int came = 0;
    while (L->end + 2 + most <= L->room) {
        ssize_t size = recv(L->descriptor, L->bytes + L->end + 2, (size_t)most, MSG_DONTWAIT);
        if (size < 0) return came || errno == EAGAIN || errno == EINTR;
        L->bytes[L->end] = (uint8_t)(size & 255);
        L->bytes[L->end + 1] = (uint8_t)(size >> 8);
        L->end += 2 + size;
        came = 1;
    }
    return 1;
}

/* Waits for bytes until `until`; returns whether the line is still ordinary. */
static int wait_for_bytes(loop *L, double until)
{
    struct pollfd line = {L->descriptor, POLLIN, 0};
    double left = until - now();
    int ready = poll(&line, 1, left > 0 ? 1 + (int)(1e3 * left) : 0);
    L->arrived = now();
    if (ready < 0) return errno == EINTR;
    if (ready == 0) return 0; /* silent: whether it is asked again is Python's to say */
    memmove(L->bytes, L->bytes + L->first, (size_t)(L->end - L->first));
    L->end -= L->first;
    L->first = 0;
    if (!L->serial) return read_datagrams(L);
    ssize_t size = read(L->descriptor, L->bytes + L->end, (size_t)(L->room - L->end));
    if (size <= 0) return size < 0 && (errno == EAGAIN || errno == EINTR);
    L->end += size;
    return 1;
}

/* The next whole message; `*after` is where the one behind it begins. */
static const uint8_t *next_message(loop *L, uint8_t *buffer, int64_t *after, int *wrong)
{
    const int64_t size = HEAD + 2 * (int64_t)L->electrodes + 4;
    *wrong = 0;
    if (!L->serial) {
        if (L->first == L->end) return NULL;
        int64_t told = L->bytes[L->first] | L->bytes[L->first + 1] << 8;
        *after = L->first + 2 + told;
        *wrong = told != size;
        return *wrong ? NULL : L->bytes + L->first + 2;
    }
    while (L->first < L->end && L->bytes[L->first] == 0) L->first++;
    const uint8_t *from = L->bytes + L->first;
    const uint8_t *zero = memchr(from, 0, (size_t)(L->end - L->first));
    if (zero == NULL) {
        *wrong = L->end - L->first > 2 * (size + TOLD); /* no message is so long */
        return NULL;
    }
    tomojax_decoder line;
    tomojax_decoder_begin(&line, buffer, (size_t)size);
    size_t found = 0;
    for (const uint8_t *byte = from; byte <= zero; byte++) found = tomojax_decode(&line, *byte);
    *after = zero + 1 - L->bytes;
    *wrong = (int64_t)found != size;
    return *wrong ? NULL : buffer;
}

static int another_waits(const loop *L, int64_t after)
{
    if (!L->serial) return after < L->end;
    return after < L->end && memchr(L->bytes + after, 0, (size_t)(L->end - after)) != NULL;
}

/* Whether a message is the slot to come, or a later one after a short loss. */
static int is_ordinary(const loop *L, const uint8_t *message, int64_t *clock, uint32_t *ahead)
{
    const size_t body = HEAD + 2 * (size_t)L->electrodes;
    *clock = (int64_t)get(message + 8, 8);
    *ahead = (uint32_t)get(message + 4, 4) - L->next;
    return message[0] == TOMOJAX_SLOT && message[1] < L->conditions &&
           get(message + 2, 2) == 0 && *ahead <= (uint32_t)L->trusted && *clock > L->last &&
           get(message + body, 4) == tomojax_crc(message, body);
}

/* Sends the next ground; returns whether the line is still ordinary. */
static int ask(loop *L, int32_t ground)
{
    uint8_t message[16] = {TOMOJAX_GROUNDS, 1, 0, 0}, coded[32];
    message[4] = (uint8_t)L->line_of[ground];
    size_t size = sealed(message, message + 5);
    ssize_t sent;
    if (L->serial)
        sent = write(L->descriptor, coded, tomojax_coded(coded, message, size));
    else
        sent = send(L->descriptor, message, size, MSG_DONTWAIT | MSG_NOSIGNAL);
    return sent >= 0 || errno == EAGAIN; /* no room: asked again where it is not heeded */
}

/* Puts what a step said of a slot, or that it was skipped, into the ring. */
static void record(loop *L, const uint8_t *codes, int64_t lost, double time, double latency,
                int answered)
{
    const int64_t written = *L->written;
    char *row = L->rows + written % L->length * L->row_bytes;
    int16_t each[256], ground = (int16_t)L->ground, next = -1;
    uint32_t flags = 0;
    uint8_t count = 0;
    float wait = NAN;
    for (int k = 0; k < L->electrodes; k++)
        each[k] = (int16_t)get(codes + 2 * L->channels[k], 2);
    if (answered) {
        wait = (float)latency;
        next = (int16_t)L->said_whole[2];
        flags = (uint32_t)L->said_whole[1];
        count = (uint8_t)L->said_whole[0];
        for (int k = 0; k < 2 * L->contacts; k++) {
            float place = (float)L->said[k];
            memcpy(row + L->at.xy + 4 * k, &place, 4);
        }
        for (int k = 0; k < L->contacts; k++) {
            float given = (float)L->said[5 * L->contacts + k];
            memcpy(row + L->at.conductance + 4 * k, &given, 4);
        }
    }
    memcpy(row + L->at.number, &L->number, 8);
    memcpy(row + L->at.lost, &lost, 8);
    memcpy(row + L->at.time, &time, 8);
    memcpy(row + L->at.latency, &wait, 4);
    memcpy(row + L->at.ground, &ground, 2);
    memcpy(row + L->at.next, &next, 2);
    memcpy(row + L->at.flags, &flags, 4);
    memcpy(row + L->at.count, &count, 1);
    memcpy(row + L->at.codes, each, 2 * (size_t)L->electrodes);
    __atomic_store_n(L->written, written + 1, __ATOMIC_RELEASE);
}

/* Runs the step on a slot; returns whether the line is still ordinary. */
static int answer(loop *L, const uint8_t *codes, double late)
{
    REAL volts[256];
    for (int k = 0; k < L->electrodes; k++) {
        float factor = L->trim[k], more = L->trim[L->electrodes + k];
        float code = (float)(int16_t)get(codes + 2 * L->channels[k], 2);
        volts[k] = (REAL)(code * (L->scale * factor) + (L->offset * factor + more));
    }
    const int64_t most = 1 << 30, lost = L->missed < most ? L->missed : most;
    const int32_t slot[3] = {L->ground, (int32_t)lost, late > L->hurry};
    L->step(L->tables, L->numbers, L->whole, volts, slot, 1, L->numbers, L->whole, L->said,
            L->said_whole);
    L->missed = 0;
    const int32_t next = L->said_whole[2];
    if (next < 0 || next >= L->conditions) return 0; /* Python refuses it in words */
    L->unheeded = L->ground == L->asked ? 0 : L->unheeded + 1;
    if (next == L->asked && L->unheeded < L->again) return 1;
    L->asked = next;
    L->unheeded = 0;
    return ask(L, next);
}

/* Works on slots until `until`, s of CLOCK_MONOTONIC, or until one is not ordinary. */
int tomojax_loop(loop *L, double until)
{
    uint8_t buffer[1024];
    int fine = 1;
    while (fine) {
        int64_t after = L->first, clock;
        uint32_t ahead;
        int wrong;
        if (now() > until) return TIME_IS_UP;
        const uint8_t *message = next_message(L, buffer, &after, &wrong);
        if (message == NULL) {
            if (wrong || !wait_for_bytes(L, until)) return NOT_ORDINARY;
            continue;
        }
        if (!is_ordinary(L, message, &clock, &ahead)) return NOT_ORDINARY;
        L->first = after;
        L->next += ahead + 1;
        L->number += ahead;
        L->lost += ahead;
        L->missed += ahead;
        L->last = clock;
        L->ground = L->electrode_of[message[1]];
        L->slots++;
        const double time = L->base + 1e-6 * (double)(clock - L->origin);
        const double late = now() - L->arrived;
        /* A step that takes less than half the time of a slot catches up by itself. */
        if (late > L->period && L->usual > L->period / 2 && another_waits(L, after)) {
            record(L, message + HEAD, ahead, time, 0, 0);
            L->skipped++;
            L->missed++;
        } else {
            fine = answer(L, message + HEAD, late);
            const double latency = now() - L->arrived;
            /* A step up or down, slot after slot: the median, which no interruption moves. */
            L->usual += (latency - late > L->usual ? 1 : -1) * L->period / 32;
            const int64_t bin = (int64_t)(1e6 * latency);
            L->latencies[bin < L->longest ? bin : L->longest - 1]++;
            record(L, message + HEAD, ahead, time, latency, 1);
        }
        L->number++;
    }
    return NOT_ORDINARY;
}
