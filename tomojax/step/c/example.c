/* Reads slots from standard input, a line each, and prints contacts and the next condition.
 *
 *     cc example.c -L. -ltomojax_step -lm -o example && ./example step.tables < vectors.txt
 *
 * A line: the condition that the slot had, slots lost before it, and the volts of all
 * electrodes; "nan" is a channel that gave nothing. Of a line that begins with -2 the slot
 * has the condition that the step has asked for. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "tomojax_step.h"

int main(int count, char **arguments)
{
    static char line[64 * TOMOJAX_ELECTRODES + 64];
    tomojax_real volts[TOMOJAX_ELECTRODES];
    tomojax_tables tables;
    tomojax_state state;
    tomojax_output out;
    const char *path = count > 1 ? arguments[1] : "step.tables";
    const char *wrong = tomojax_step_load(path, &tables);
    int32_t next;
    if (wrong != NULL) {
        fprintf(stderr, "%s: %s\n", path, wrong);
        return 2;
    }
    next = tomojax_step_init(&tables, &state);
    while (fgets(line, sizeof line, stdin) != NULL) {
        char *at = line, *end;
        long condition = strtol(at, &at, 10);
        const long lost = strtol(at, &at, 10);
        if (condition == -2) condition = next;
        for (int k = 0; k < TOMOJAX_ELECTRODES; k++, at = end) {
            volts[k] = (tomojax_real)strtod(at, &end);
            if (end == at) volts[k] = NAN;
        }
        tomojax_step(&tables, &state, volts, (int32_t)condition, (int32_t)lost, 0, &out);
        next = out.next_condition;
        printf("%d %d %d", (int)out.next_condition, (int)out.flags, (int)out.count);
        for (int k = 0; k < out.count; k++)
            printf(" %.6f %.6f", (double)out.xy[k][0], (double)out.xy[k][1]);
        printf("\n");
    }
    tomojax_step_free(&tables);
    return 0;
}
