/* Runs the test vectors: slots with the memory before each, and what JAX says of them.
 *
 *     cc check.c -L. -ltomojax_step -lm -o check && ./check step.tables vectors.bin
 *
 * It fails where more than one slot in two hundred differs in flags, count or next condition,
 * or more than one in a hundred has a place that is a hundredth of a radius away. Numbers
 * are rounded otherwise on another processor, which decides otherwise where a slot lies
 * between two decisions: JAX's own float32 and float64 differ in one slot of 250. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include "tomojax_step.h"

typedef struct {
    tomojax_state state;
    tomojax_real volts[TOMOJAX_ELECTRODES];
    int32_t slot[3];
    tomojax_output out;
} vector;

static int field(void *to, size_t size, FILE *file) { return fread(to, size, 1, file) == 1; }

int main(int count, char **arguments)
{
    static vector v; /* in the file without gaps between its parts */
    tomojax_tables tables;
    tomojax_output out;
    long slots = 0, differ = 0, away = 0;
    double most = 0;
    const char *wrong = count == 3 ? tomojax_step_load(arguments[1], &tables)
                                   : "expected two files: step.tables vectors.bin";
    FILE *file = wrong == NULL ? fopen(arguments[2], "rb") : NULL;
    if (file == NULL) {
        fprintf(stderr, "%s\n", wrong != NULL ? wrong : "vectors: no such file");
        return 2;
    }
    while (field(v.state.numbers, sizeof v.state.numbers, file) &&
           field(v.state.whole, sizeof v.state.whole, file) &&
           field(v.volts, sizeof v.volts, file) && field(v.slot, sizeof v.slot, file) &&
           field(v.out.xy, offsetof(tomojax_output, count), file) &&
           field(&v.out.count, 3 * sizeof v.out.count, file)) {
        tomojax_step(&tables, &v.state, v.volts, v.slot[0], v.slot[1], v.slot[2], &out);
        slots++;
        if (out.count != v.out.count || out.flags != v.out.flags ||
            out.next_condition != v.out.next_condition) {
            differ++;
            continue;
        }
        for (int k = 0; k < out.count; k++) {
            const double x = out.xy[k][0] - v.out.xy[k][0], y = out.xy[k][1] - v.out.xy[k][1];
            const double gap = sqrt(x * x + y * y);
            if (gap > most) most = gap;
            if (!(gap <= 0.01 * v.out.radius[k])) {
                away++;
                break;
            }
        }
    }
    fclose(file);
    tomojax_step_free(&tables);
    printf("%ld slots: %ld differ, %ld places are away, by %.2g m at most\n", slots, differ,
           away, most);
    return slots == 0 || differ * 200 > slots || away * 100 > slots;
}
