/* The test vectors of ../PROTOCOL.md: prints "ok", or what differs.
 *
 *     cc -std=c99 test_vectors.c tomojax_rig.c -o vectors && ./vectors
 */
#include <stdio.h>
#include <string.h>

#include "tomojax_rig.h"

static int failed;

static void same(const char *name, const uint8_t *found, size_t size, const char *expected)
{
    char told[256] = "";
    for (size_t k = 0; k < size && k < 80; k++)
        sprintf(told + 3 * k, "%02x ", (unsigned)found[k]);
    told[3 * size - 1] = '\0';
    if (strcmp(told, expected) != 0) {
        printf("%s: got %s, expected %s\n", name, told, expected);
        failed = 1;
    }
}

static void command(const uint8_t *bytes, size_t size, unsigned kind, unsigned count)
{
    uint8_t buffer[TOMOJAX_ROW_SIZE(4)];
    tomojax_decoder line;
    tomojax_command told = {TOMOJAX_NONE, 0, NULL, 0, 0, 0, NULL};
    tomojax_decoder_begin(&line, buffer, sizeof buffer);
    for (size_t k = 0; k < size; k++) {
        size_t length = tomojax_decode(&line, bytes[k]);
        if (length != 0)
            told = tomojax_command_of(buffer, length, 4, 4);
    }
    int grounds = kind != TOMOJAX_GROUNDS || memcmp(told.grounds, "\0\2\3", 3) == 0;
    if (told.rows != 0) /* 0, 0.5, 0.125 and 0 S */
        grounds = told.rows == 2 && told.row == 1 && told.table == 0x7E38813Eu &&
                  tomojax_conductance(&told, 1) == 0x3F000000u &&
                  tomojax_conductance(&told, 2) == 0x3E000000u;
    if (told.kind != kind || told.count != count || !grounds || line.bad != 0) {
        printf("command: got %u, expected %u\n", told.kind, kind);
        failed = 1;
    }
}

int main(void)
{
    static const uint8_t start[] = {3, 0x10, 1, 1, 5, 0xb4, 0xe2, 0x9f, 0x70, 0};
    static const uint8_t stop[] = {3, 0x11, 1, 1, 5, 0xd1, 0x85, 0x23, 0xc8, 0};
    static const uint8_t ground[] = {3, 0x12, 3,    1,    1,    7,   2,
                                     3, 0x0f, 0x13, 0x86, 0x40, 0x00};
    static const int16_t codes[] = {0, -1, 1000, -32767 - 1};
    static const uint8_t row[] = {4, 0x10, 2, 2, 6, 0x3e, 0x81, 0x38, 0x7e, 1, 1, 1, 1,
                                  1, 1,    1, 1, 1, 1,    2,    0x3f, 1,    1, 2, 0x3e, 1,
                                  1, 1,    5, 0x9c, 0x56, 0xc0, 0xc9, 0};
    tomojax_told told = {4, 0xA1B2C3D4u, 7, 0x40C3880000000000u, 0x3F20000000000000u, 0,
                         1, 0,           0};
    uint8_t message[64], coded[80];
    uint8_t digits[9];
    memcpy(digits, "123456789", 9);
    if (tomojax_crc(digits, 9) != 0xCBF43926u) {
        printf("crc: got %08lx\n", (unsigned long)tomojax_crc(digits, 9));
        failed = 1;
    }
    command(start, sizeof start, TOMOJAX_START, 0);
    command(stop, sizeof stop, TOMOJAX_STOP, 0);
    command(ground, sizeof ground, TOMOJAX_GROUNDS, 3);
    command(row, sizeof row, TOMOJAX_START, 0);
    size_t size = tomojax_description(message, &told);
    same("description", coded, tomojax_coded(coded, message, size),
         "04 02 01 04 06 d4 c3 b2 a1 07 01 01 01 01 01 01 01 04 88 c3 40 01 01 01 01 01 03 "
         "20 3f 01 01 01 01 01 01 01 05 d3 44 75 3d 00");
    told.version = TOMOJAX_TABLES;
    told.held = 2;
    told.table = 0x7E38813Eu;
    size = tomojax_description(message, &told);
    same("description with a table", coded, tomojax_coded(coded, message, size),
         "04 02 02 04 06 d4 c3 b2 a1 07 01 01 01 01 01 01 01 04 88 c3 40 01 01 01 01 01 03 "
         "20 3f 01 01 01 01 01 01 01 06 3e 81 38 7e 02 01 01 05 58 b7 7a 2c 00");
    size = tomojax_slot(message, 2, 300, 123456789u, codes, 4);
    same("slot", coded, tomojax_coded(coded, message, size),
         "03 01 02 01 03 2c 01 01 05 15 cd 5b 07 01 01 01 01 01 05 ff ff e8 03 06 80 d2 45 "
         "83 f2 00");
    if (!failed)
        puts("ok");
    return failed;
}
