/* The firmware's functions for firmware.py: records in, what a line carries out.
 *
 * `peer encode`: 0x01 m ground sequence µs codes, or 0x02 and a description, each number
 * little-endian; out come coded messages. `peer decode M`: a line's bytes; out come kind,
 * count, grounds and row of each command, and last the count of what was none.
 * With -DFUZZER it is libFuzzer's target. Buffers are of the size that is promised: a
 * sanitizer sees a byte beyond.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tomojax_rig.h"

static void decode(const uint8_t *bytes, size_t size, uint16_t m, FILE *out)
{
    tomojax_decoder line;
    size_t room = 16u + 4u * (size_t)m; /* a row, or two grounds of one electrode */
    uint8_t *buffer = malloc(room);
    tomojax_decoder_begin(&line, buffer, room);
    for (size_t k = 0; k < size; k++) {
        size_t length = tomojax_decode(&line, bytes[k]);
        if (length == 0)
            continue;
        if (length > room)
            abort();
        tomojax_command told = tomojax_command_of(buffer, length, m, m);
        if (told.kind == TOMOJAX_NONE)
            continue;
        for (unsigned g = 0; g < told.count; g++)
            if (told.grounds[g] >= m)
                abort();
        if (out != NULL) {
            fputc(told.kind, out);
            fputc(told.count, out);
            fwrite(told.grounds, 1, told.count, out);
            uint64_t row = (uint64_t)told.rows << 48 | (uint64_t)told.row << 32 | told.table;
            if (told.rows != 0)
                fwrite(&row, 1, 8, out);
            for (uint16_t k = 0; told.rows != 0 && k < m; k++) {
                uint32_t bits = tomojax_conductance(&told, k);
                fwrite(&bits, 1, 4, out);
            }
        }
    }
    if (out != NULL)
        fprintf(out, "%10lu", (unsigned long)line.bad);
    free(buffer);
}

#ifdef FUZZER
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size == 0)
        return 0;
    decode(data + 1, size - 1, (uint16_t)(data[0] + 1u), NULL);
    uint16_t m = (uint16_t)(data[0] + 1u);
    (void)tomojax_command_of(data + 1, size - 1, m, m);
    /* What was encoded has no zero but its last byte, and the promised length. */
    uint8_t *coded = malloc(TOMOJAX_CODED_SIZE(size));
    size_t length = tomojax_coded(coded, data, size);
    if (length > TOMOJAX_CODED_SIZE(size) || memchr(coded, 0, length) != coded + length - 1)
        abort();
    uint8_t *back = malloc(size);
    size_t found = 0;
    tomojax_decoder line;
    tomojax_decoder_begin(&line, back, size);
    for (size_t k = 0; k < length; k++)
        found = tomojax_decode(&line, coded[k]);
    if (found != size || memcmp(back, data, size) != 0)
        abort();
    free(back);
    free(coded);
    return 0;
}
#else
static int take(uint64_t *value, unsigned bytes)
{
    *value = 0;
    for (unsigned k = 0; k < bytes; k++) {
        int byte = getchar();
        if (byte == EOF)
            return 0;
        *value |= (uint64_t)byte << (8 * k);
    }
    return 1;
}

static void give(const uint8_t *message, size_t size)
{
    uint8_t *coded = malloc(TOMOJAX_CODED_SIZE(size));
    fwrite(coded, 1, tomojax_coded(coded, message, size), stdout);
    free(coded);
}

static void encode(void)
{
    uint64_t kind, m, a, b, c, d, e, f, v, h, t;
    while (take(&kind, 1) && take(&m, 2)) {
        if (kind == TOMOJAX_SLOT) {
            take(&a, 1), take(&b, 4), take(&c, 8);
            int16_t *codes = malloc(2 * (size_t)m);
            for (size_t k = 0; k < m; k++) {
                uint16_t bits;
                take(&d, 2);
                bits = (uint16_t)d;
                memcpy(codes + k, &bits, 2);
            }
            uint8_t *message = malloc(TOMOJAX_SLOT_SIZE((size_t)m));
            give(message, tomojax_slot(message, (uint8_t)a, (uint32_t)b, c, codes,
                                       (uint16_t)m));
            free(message);
            free(codes);
        } else {
            take(&a, 4), take(&b, 4), take(&d, 8), take(&e, 8), take(&f, 8);
            take(&v, 2), take(&h, 2), take(&t, 4);
            tomojax_told told = {(uint16_t)m, (uint32_t)a, (uint32_t)b, d, e, f,
                                 (uint16_t)v, (uint16_t)h,  (uint32_t)t};
            uint8_t *message = malloc(TOMOJAX_DESCRIPTION_SIZE);
            give(message, tomojax_description(message, &told));
            free(message);
        }
    }
}

int main(int argc, char **argv)
{
    if (argc < 3) {
        encode();
        return 0;
    }
    static uint8_t bytes[1 << 26];
    size_t size = fread(bytes, 1, sizeof bytes, stdin);
    decode(bytes, size, (uint16_t)atoi(argv[2]), stdout);
    return 0;
}
#endif
