
/* The step's face: see tomojax_step.h. */
#include <stdio.h>
#include <stdlib.h>
#include "tomojax_step.h"

enum { HEAD = 64, FIRST_NUMBERS = @FIRST_NUMBERS@, FIRST_WHOLE = @FIRST_WHOLE@ };

static uint32_t checksum(const unsigned char *bytes, size_t size)
{
    /* CRC-32 of zlib, four bits at a time. */
    uint32_t table[16], crc = 0xffffffffu;
    for (uint32_t k = 0; k < 16; k++) {
        uint32_t c = k;
        for (int bit = 0; bit < 4; bit++) c = c & 1 ? 0xedb88320u ^ (c >> 1) : c >> 1;
        table[k] = c;
    }
    for (size_t k = 0; k < size; k++) {
        crc ^= bytes[k];
        crc = table[crc & 15] ^ (crc >> 4);
        crc = table[crc & 15] ^ (crc >> 4);
    }
    return ~crc;
}

const char *tomojax_step_use(const void *bytes, size_t size, tomojax_tables *tables)
{
    const unsigned char *head = (const unsigned char *)bytes;
    uint32_t crc;
    tables->data = NULL;
    tables->own = NULL;
    if (size < HEAD || memcmp(head, "TOMOJAX STEP 1\n", 15) != 0)
        return "tables: got another kind of file, expected tables of a step, version 1";
    if (memcmp(head + 16, TOMOJAX_CODE, 32) != 0)
        return "tables: got those of another step's code, expected tables of " TOMOJAX_CODE;
    if (size != HEAD + (size_t)TOMOJAX_TABLE_BYTES)
        return "tables: got a file that was cut or grew, expected its whole length";
    if ((uintptr_t)bytes % 64 != 0)
        return "tables: got an address within a line of 64 bytes, expected its beginning";
    memcpy(&crc, head + 48, 4);
    if (checksum(head + HEAD, TOMOJAX_TABLE_BYTES) != crc)
        return "tables: got bytes that have changed, expected those of their checksum";
    tables->data = head + HEAD;
    return NULL;
}

const char *tomojax_step_load(const char *path, tomojax_tables *tables)
{
    const size_t most = HEAD + (size_t)TOMOJAX_TABLE_BYTES + 1;
    char *own = (char *)malloc(most + 64);
    FILE *file = own == NULL ? NULL : fopen(path, "rb");
    const char *wrong = own == NULL ? "tables: no memory" : "tables: no such file";
    tables->data = NULL;
    tables->own = NULL;
    if (file != NULL) {
        char *start = own + (64 - (uintptr_t)own % 64);
        wrong = tomojax_step_use(start, fread(start, 1, most, file), tables);
        fclose(file);
    }
    if (wrong != NULL) free(own);
    else tables->own = own;
    return wrong;
}

void tomojax_step_free(tomojax_tables *tables)
{
    free(tables->own);
    tables->data = tables->own = NULL;
}

int32_t tomojax_step_init(const tomojax_tables *tables, tomojax_state *state)
{
    const char *T = (const char *)tables->data;
    memcpy(state->numbers, T + FIRST_NUMBERS, sizeof state->numbers);
    memcpy(state->whole, T + FIRST_WHOLE, sizeof state->whole);
    return state->whole[@GROUND_AT@];
}

void tomojax_step(const tomojax_tables *tables, tomojax_state *state,
                  const tomojax_real *volts, int32_t condition, int32_t lost, int32_t hurried,
                  tomojax_output *out)
{
    const int32_t slot[3] = {condition, lost, hurried};
    run_step((const char *)tables->data, state->numbers, state->whole, volts, slot,
             state->numbers, state->whole, &out->xy[0][0], &out->count);
}

void tomojax_step_image(const tomojax_tables *tables, const tomojax_state *state,
                        tomojax_real *image)
{
    run_image((const char *)tables->data, state->numbers, state->whole, image);
}

void tomojax_step_switch(tomojax_state *state, int32_t policy)
{
    if (policy < 0 || policy >= TOMOJAX_POLICIES) return;
    state->whole[@POLICY_AT@] = policy;
    state->whole[@LENGTH_AT@] = 0;
}

/* For Python, which holds the arrays: slots one after the other, states apart. */
void tomojax_step_arrays(const char *T, const tomojax_real *numbers, const int32_t *whole,
                         const tomojax_real *volts, const int32_t *slots, int64_t count,
                         tomojax_real *numbers_after, int32_t *whole_after,
                         tomojax_real *said, int32_t *said_whole)
{
    for (int64_t k = 0; k < count; k++) {
        run_step(T, numbers, whole, volts + k * TOMOJAX_ELECTRODES, slots + 3 * k,
                 numbers_after, whole_after, said + k * @SAID_NUMBERS@,
                 said_whole + k * @SAID_WHOLE@);
        numbers = numbers_after;
        whole = whole_after;
    }
}

void tomojax_image_arrays(const char *T, const tomojax_real *numbers, const int32_t *whole,
                          tomojax_real *image)
{
    run_image(T, numbers, whole, image);
}

void tomojax_state_sizes(int64_t *sizes)
{
    sizes[0] = @NUMBERS@;
    sizes[1] = @WHOLE@;
}

void tomojax_first_arrays(const char *T, tomojax_real *numbers, int32_t *whole)
{
    memcpy(numbers, T + FIRST_NUMBERS, @NUMBERS@ * sizeof *numbers);
    memcpy(whole, T + FIRST_WHOLE, @WHOLE@ * sizeof *whole);
}
