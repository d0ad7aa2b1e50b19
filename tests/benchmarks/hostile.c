/* Gives a step slots that no rig sends: NaN, infinities, wrong grounds, broken memories.
 *
 *     hostile step.tables 1000000
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include "tomojax_step.h"
static uint32_t seed = 1;
static uint32_t next(void) { return seed = seed * 1664525u + 1013904223u; }
int main(int count, char **arguments)
{
    tomojax_tables tables;
    tomojax_state state;
    tomojax_output out;
    tomojax_real volts[TOMOJAX_ELECTRODES];
    const float odd[] = {NAN, INFINITY, -INFINITY, 0, 1e38f, -1e-40f, 3, 40};
    if (count < 3) return 2;
    const int slots = atoi(arguments[2]);
    if (tomojax_step_load(arguments[1], &tables) != NULL) return 1;
    tomojax_step_init(&tables, &state);
    for (int k = 0; k < slots; k++) {
        const uint32_t kind = next() >> 29;
        for (int e = 0; e < TOMOJAX_ELECTRODES; e++)
            volts[e] = next() % 16 < kind ? odd[next() >> 29] : (next() >> 8) / 5.6e6f;
        if (next() % 1000 == 0)  /* a memory that nothing has written */
            for (size_t n = 0; n < sizeof state.numbers / sizeof *state.numbers; n++)
                state.numbers[n] = odd[next() >> 29];
        if (next() % 1000 == 0)
            for (size_t n = 0; n < sizeof state.whole / sizeof *state.whole; n++)
                state.whole[n] = (int32_t)next();
        const int32_t condition = (int32_t)(next() % 20) - 2 + (k % 99 ? 0 : 2000000);
        const int32_t lost = (int32_t)(next() % 3 ? 0 : next());
        tomojax_step(&tables, &state, volts, condition, lost, next() >> 31, &out);
        tomojax_step_switch(&state, (int32_t)(next() % 9) - 3);
    }
    printf("%d slots\n", slots);
    tomojax_step_free(&tables);
    return 0;
}
