/* See tomojax_rig.h. */
#include "tomojax_rig.h"

static uint8_t *put(uint8_t *out, uint64_t value, unsigned bytes)
{
    for (; bytes > 0; bytes--, value >>= 8)
        *out++ = (uint8_t)(value & 0xFFu);
    return out;
}

uint32_t tomojax_crc(const uint8_t *bytes, size_t count)
{
    /* Half a byte at a time: 64 bytes of table, where one for whole bytes has 1024. */
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
        0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
        0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};
    uint32_t crc = 0xFFFFFFFFu;
    while (count-- > 0) {
        crc ^= *bytes++;
        crc = (crc >> 4) ^ table[crc & 15u];
        crc = (crc >> 4) ^ table[crc & 15u];
    }
    return crc ^ 0xFFFFFFFFu;
}

static size_t sealed(uint8_t *out, const uint8_t *end)
{
    size_t count = (size_t)(end - out);
    put(out + count, tomojax_crc(out, count), 4);
    return count + 4;
}

size_t tomojax_slot(uint8_t *out, uint8_t ground, uint32_t sequence, uint64_t microseconds,
                    const int16_t *codes, uint16_t electrodes)
{
    uint8_t *at = out;
    *at++ = TOMOJAX_SLOT;
    *at++ = ground;
    at = put(at, 0, 2);
    at = put(at, sequence, 4);
    at = put(at, microseconds, 8);
    for (uint16_t k = 0; k < electrodes; k++)
        at = put(at, (uint16_t)codes[k], 2);
    return sealed(out, at);
}

size_t tomojax_description(uint8_t *out, const tomojax_told *told)
{
    uint8_t *at = out;
    *at++ = TOMOJAX_DESCRIPTION;
    *at++ = told->version == TOMOJAX_TABLES ? TOMOJAX_TABLES : TOMOJAX_VERSION;
    at = put(at, told->electrodes, 2);
    at = put(at, told->session, 4);
    at = put(at, told->sequence, 4);
    at = put(at, told->rate, 8);
    at = put(at, told->scale, 8);
    at = put(at, told->offset, 8);
    if (told->version == TOMOJAX_TABLES) {
        at = put(at, told->table, 4);
        at = put(at, told->held, 2);
        at = put(at, 0, 2);
    }
    return sealed(out, at);
}

size_t tomojax_coded(uint8_t *out, const uint8_t *message, size_t count)
{
    size_t code = 0, end = 1; /* where this block's code goes, and its next byte */
    for (size_t k = 0; k < count; k++) {
        if (message[k] != 0)
            out[end++] = message[k];
        /* A block of 254 bytes says of itself that no zero follows. */
        int full = end - code == 255 && k + 1 < count;
        if (message[k] == 0 || full) {
            out[code] = (uint8_t)(end - code);
            code = end++;
        }
    }
    out[code] = (uint8_t)(end - code);
    out[end++] = 0;
    return end;
}

static void begin(tomojax_decoder *line)
{
    line->length = line->coded = 0;
    line->code = line->left = line->broken = 0;
}

void tomojax_decoder_begin(tomojax_decoder *line, uint8_t *buffer, size_t room)
{
    line->buffer = buffer;
    line->room = room;
    line->bad = 0;
    begin(line);
}

static void add(tomojax_decoder *line, uint8_t byte)
{
    if (line->length < line->room)
        line->buffer[line->length++] = byte;
    else
        line->broken = 1; /* too long: nothing is a message until the next 0x00 */
}

size_t tomojax_decode(tomojax_decoder *line, uint8_t byte)
{
    if (byte == 0) {
        size_t length = line->length;
        if (line->coded != 0 && (line->broken || line->left != 0 || length == 0)) {
            line->bad++;
            length = 0;
        }
        begin(line);
        return length;
    }
    if (line->left == 0) { /* a block begins: a zero was before it, or 254 bytes were */
        if (line->coded != 0 && line->code != 255)
            add(line, 0);
        line->code = byte;
        line->left = (uint8_t)(byte - 1);
    } else {
        add(line, byte);
        line->left--;
    }
    line->coded = 1;
    return 0;
}

static uint64_t get(const uint8_t *from, unsigned bytes)
{
    uint64_t value = 0;
    while (bytes-- > 0)
        value = value << 8 | from[bytes];
    return value;
}

uint32_t tomojax_conductance(const tomojax_command *start, uint16_t electrode)
{
    return (uint32_t)get(start->conductances + 4u * electrode, 4);
}

/* A START with a row of a table: finite conductances from 0 up, one of them above. */
static int is_row(const uint8_t *message, size_t count, uint16_t electrodes,
                  tomojax_command *found)
{
    if (count != TOMOJAX_ROW_SIZE((size_t)electrodes) || message[0] != TOMOJAX_START ||
        message[1] != TOMOJAX_TABLES)
        return 0;
    found->rows = (uint16_t)get(message + 2, 2);
    found->table = (uint32_t)get(message + 4, 4);
    found->row = (uint16_t)get(message + 8, 2);
    found->conductances = message + 12;
    int grounded = 0;
    for (uint16_t k = 0; k < electrodes; k++) {
        uint32_t bits = tomojax_conductance(found, k);
        if (bits >= 0x7F800000u && bits != 0x80000000u) /* infinite, NaN, or below 0 */
            return 0;
        grounded |= (bits & 0x7FFFFFFFu) != 0;
    }
    return grounded && found->row < found->rows && found->rows <= TOMOJAX_MOST &&
           get(message + 10, 2) == 0;
}

static int is_command(const uint8_t *message, size_t count, uint16_t conditions,
                      tomojax_command *found)
{
    if (count > TOMOJAX_COMMAND_SIZE((size_t)conditions) || get(message + 2, 2) != 0)
        return 0;
    size_t grounds = count - 8;
    found->count = (uint8_t)grounds;
    if (message[0] != TOMOJAX_GROUNDS)
        return (message[0] == TOMOJAX_START || message[0] == TOMOJAX_STOP) &&
               grounds == 0 && message[1] == TOMOJAX_VERSION;
    for (size_t k = 0; k < grounds; k++)
        if (message[4 + k] >= conditions)
            return 0;
    return grounds != 0 && message[1] == grounds;
}

tomojax_command tomojax_command_of(const uint8_t *message, size_t count,
                                   uint16_t electrodes, uint16_t conditions)
{
    static const tomojax_command none = {TOMOJAX_NONE, 0, NULL, 0, 0, 0, NULL};
    tomojax_command found = none;
    if (count < 8 || get(message + count - 4, 4) != tomojax_crc(message, count - 4))
        return none;
    if (!is_command(message, count, conditions, &found)) {
        found = none;
        if (!is_row(message, count, electrodes, &found))
            return none;
    }
    found.kind = message[0];
    found.grounds = message + 4;
    return found;
}
