/* Reads the datagrams of `tomojax live --send udp://HOST:PORT`, version 1.
 *
 * Little-endian. A head of 32 bytes, then 20 bytes for each contact:
 *
 *   bytes  what
 *   2      0x4A54 ("TJ")
 *   1      version, 1
 *   1      kind: 1 a row, 2 touch-down, 3 lift-off
 *   4      number of the datagram: one more each, modulo 2^32; a step tells of lost ones
 *   8      number of the slot, lost ones count; -1 of a lift-off when the loop ends
 *   8      time of the rig's clock, s, IEEE 754 double; of an event its own
 *   4      flags, bits of tomojax.Flag
 *   1      contacts: strongest first; 1 of an event
 *   3      0
 *   4      a contact's number; 0 until a second row has shown it
 *   4 x 4  x, m; y, m; conductance, S; force, N: IEEE 754 floats, NaN where not known
 *
 * A datagram of another version, or of another length, is none of these: it is dropped.
 */
#ifndef TOMOJAX_CONTACTS_H
#define TOMOJAX_CONTACTS_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define TOMOJAX_MOST_CONTACTS 16

enum { TOMOJAX_ROW = 1, TOMOJAX_TOUCH_DOWN = 2, TOMOJAX_LIFT_OFF = 3 };

typedef struct {
    uint32_t number;
    float x, y;        /* m */
    float conductance; /* S */
    float force;       /* N; NaN where it is not known */
} tomojax_contact;

typedef struct {
    uint8_t kind;
    uint32_t sequence;
    int64_t slot;
    double time; /* s */
    uint32_t flags;
    uint8_t count;
    tomojax_contact contact[TOMOJAX_MOST_CONTACTS];
} tomojax_packet;

static inline uint32_t tomojax_u32(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 |
           (uint32_t)p[3] << 24;
}

static inline float tomojax_f32(const uint8_t *p)
{
    uint32_t bits = tomojax_u32(p);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Returns 1 for a datagram that is one of these, 0 for anything else. */
static inline int tomojax_read(const uint8_t *data, size_t size, tomojax_packet *to)
{
    uint64_t bits;
    size_t k;
    if (size < 32 || data[0] != 0x54 || data[1] != 0x4A || data[2] != 1)
        return 0;
    if (data[3] < TOMOJAX_ROW || data[3] > TOMOJAX_LIFT_OFF)
        return 0;
    if (data[28] > TOMOJAX_MOST_CONTACTS || size != 32 + 20 * (size_t)data[28])
        return 0;
    to->kind = data[3];
    to->sequence = tomojax_u32(data + 4);
    bits = (uint64_t)tomojax_u32(data + 8) | (uint64_t)tomojax_u32(data + 12) << 32;
    memcpy(&to->slot, &bits, sizeof bits);
    bits = (uint64_t)tomojax_u32(data + 16) | (uint64_t)tomojax_u32(data + 20) << 32;
    memcpy(&to->time, &bits, sizeof bits);
    to->flags = tomojax_u32(data + 24);
    to->count = data[28];
    for (k = 0; k < to->count; k++) {
        const uint8_t *p = data + 32 + 20 * k;
        to->contact[k].number = tomojax_u32(p);
        to->contact[k].x = tomojax_f32(p + 4);
        to->contact[k].y = tomojax_f32(p + 8);
        to->contact[k].conductance = tomojax_f32(p + 12);
        to->contact[k].force = tomojax_f32(p + 16);
    }
    return 1;
}

#endif
