/* A rig's side of ../PROTOCOL.md, versions 1 and 2, in C99: no allocation, no floating point.
 *
 * Fits any core with 8-bit bytes and 64-bit integers, of either byte order. The functions
 * write into and read from buffers that the caller owns; none of them keeps state but
 * tomojax_decoder.
 */
#ifndef TOMOJAX_RIG_H
#define TOMOJAX_RIG_H

#include <stddef.h>
#include <stdint.h>

#define TOMOJAX_VERSION 1u
#define TOMOJAX_TABLES 2u /* the version of a START with a table, and of the answer */
#define TOMOJAX_MOST 256u /* electrodes */

/* Bytes of messages, and of what a serial line carries for n of them, its 0x00 included. */
#define TOMOJAX_SLOT_SIZE(m) (20u + 2u * (m))
#define TOMOJAX_DESCRIPTION_SIZE 48u /* 40 of version 1 */
#define TOMOJAX_COMMAND_SIZE(m) (8u + (m))
#define TOMOJAX_ROW_SIZE(m) (16u + 4u * (m)) /* no command is longer, of m > 2 */
#define TOMOJAX_CODED_SIZE(n) ((n) + (n) / 254u + 2u)

enum { /* kinds of message */
    TOMOJAX_NONE = 0,
    TOMOJAX_SLOT = 0x01,
    TOMOJAX_DESCRIPTION = 0x02,
    TOMOJAX_START = 0x10,
    TOMOJAX_STOP = 0x11,
    TOMOJAX_GROUNDS = 0x12
};

/* What a rig says of itself. The three doubles are the bits of IEEE 754 doubles: many
 * microcontrollers' compilers have no such type. tomojax_bits makes them elsewhere; Python
 * does so anywhere: hex(struct.unpack("<Q", struct.pack("<d", 10e3))[0]). */
typedef struct {
    uint16_t electrodes;
    uint32_t session;  /* another one each time that the rig is switched on */
    uint32_t sequence; /* of the next slot */
    uint64_t rate;     /* slots a second */
    uint64_t scale;    /* V per code */
    uint64_t offset;   /* V */
    uint16_t version;  /* TOMOJAX_VERSION, or TOMOJAX_TABLES in answer to such a START */
    uint16_t held;     /* rows of the table that are here, from the first on */
    uint32_t table;    /* as that START told it */
} tomojax_told;

/* A command. Its pointers go into the message that it was read from. */
typedef struct {
    uint8_t kind; /* TOMOJAX_NONE: the message was none */
    uint8_t count;
    const uint8_t *grounds;
    uint16_t rows; /* of a START's table; 0: it has none */
    uint16_t row;  /* which row this START brings, by tomojax_conductance */
    uint32_t table;
    const uint8_t *conductances;
} tomojax_command;

/* Bytes of a serial line into messages. Its buffer needs TOMOJAX_COMMAND_SIZE(m) bytes, or
 * TOMOJAX_ROW_SIZE(m) where the rig takes tables. */
typedef struct {
    uint8_t *buffer;
    size_t room, length, coded;
    uint8_t code, left, broken;
    uint32_t bad; /* pieces that were no message so far */
} tomojax_decoder;

/* CRC-32 of zlib and Ethernet. A hardware unit does as well: polynomial 0x04C11DB7, bits
 * of input and output reversed, start and final XOR 0xFFFFFFFF. Check "123456789". */
uint32_t tomojax_crc(const uint8_t *bytes, size_t count);

/* The message's bytes into `out`; returns how many. */
size_t tomojax_slot(uint8_t *out, uint8_t ground, uint32_t sequence, uint64_t microseconds,
                    const int16_t *codes, uint16_t electrodes);
size_t tomojax_description(uint8_t *out, const tomojax_told *told);

/* What a serial line carries for a message, its 0x00 included; returns how many bytes. */
size_t tomojax_coded(uint8_t *out, const uint8_t *message, size_t count);

void tomojax_decoder_begin(tomojax_decoder *line, uint8_t *buffer, size_t room);

/* One byte more. Returns the length of the message that it ends in `buffer`, else 0. The
 * message is there until the next call. */
size_t tomojax_decode(tomojax_decoder *line, uint8_t byte);

/* A message to a rig of so many electrodes, from a line or a datagram. `conditions`: so many
 * grounds there are, the rows of a table that is here, else as many as electrodes. */
tomojax_command tomojax_command_of(const uint8_t *message, size_t count,
                                   uint16_t electrodes, uint16_t conditions);

/* Bits of an IEEE 754 float: an electrode's conductance to ground, S; 0 where it is open. */
uint32_t tomojax_conductance(const tomojax_command *start, uint16_t electrode);

/* Bits of a double, where the compiler's double is IEEE 754's. */
#include <float.h>
#if DBL_MANT_DIG == 53
#include <string.h>
static inline uint64_t tomojax_bits(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}
#endif

#endif
