/* A step of tomojax: from one slot after another to contacts and the next ground.
 *
 * Code @CODE@, written by tomojax @VERSION@ for @METHOD@ with
 * @ELECTRODES@ electrodes, @CONDITIONS@ conditions, @CONTACTS@ contacts and the policies
 * @POLICIES@.
 *
 *     tomojax_tables tables;
 *     const char *wrong = tomojax_step_load("step.tables", &tables);
 *     tomojax_state state;
 *     tomojax_step_init(&tables, &state);
 *     for (;;) {
 *         ...                         read the slot's volts, and which condition it had
 *         tomojax_step(&tables, &state, volts, condition, lost, 0, &out);
 *         ...                         out.next_condition goes to the rig
 *     }
 *
 * A step allocates nothing, locks nothing, calls the system for nothing and keeps nothing
 * but what is in `state`: as many as you like run side by side on the same tables. It needs
 * memcpy and C's mathematics. Bad input raises nothing: `out.flags` tells of it.
 */
#ifndef TOMOJAX_STEP_H
#define TOMOJAX_STEP_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TOMOJAX_CODE "@CODE@"
#define TOMOJAX_ELECTRODES @ELECTRODES@
#define TOMOJAX_CONDITIONS @CONDITIONS@
#define TOMOJAX_CONTACTS @CONTACTS@
#define TOMOJAX_POLICIES @POLICY_COUNT@
#define TOMOJAX_NX @NX@ /* pixels of an image along x, */
#define TOMOJAX_NY @NY@ /* and along y: image[i * TOMOJAX_NY + j] */
#define TOMOJAX_TABLE_BYTES @BYTES@

typedef @T@ tomojax_real;

/* What a step remembers: plain numbers, to be copied, sent or kept as they are. */
typedef struct {
    tomojax_real numbers[@NUMBERS@];
    int32_t whole[@WHOLE@];
} tomojax_state;

/* Contacts, strongest first; NaN beyond `count`. */
typedef struct {
    tomojax_real xy[TOMOJAX_CONTACTS][2];         /* m */
    tomojax_real radius[TOMOJAX_CONTACTS];        /* m */
    tomojax_real angle[TOMOJAX_CONTACTS];         /* rad; NaN where round */
    tomojax_real current[TOMOJAX_CONTACTS];       /* A */
    tomojax_real conductance[TOMOJAX_CONTACTS];   /* S; NaN where it is not known */
    tomojax_real covariance[TOMOJAX_CONTACTS][3]; /* of the place, xx, yy, xy, m^2 */
    tomojax_real residual;                        /* V rms */
    int32_t count;
    int32_t flags;          /* bits of tomojax.Flag */
    int32_t next_condition; /* to be grounded next */
} tomojax_output;

/* The numbers of one rig. They are read, never written: threads may share them. */
typedef struct {
    const void *data; /* begins on a line of 64 bytes */
    void *own;        /* what tomojax_step_load has allocated */
} tomojax_tables;

/* Reads a file of tables. Returns NULL, or a sentence that says what is wrong with it. */
const char *tomojax_step_load(const char *path, tomojax_tables *tables);

/* The same for a file's bytes that are in memory already, on a line of 64 bytes: nothing
 * is copied. For boards without files. */
const char *tomojax_step_use(const void *bytes, size_t size, tomojax_tables *tables);

/* Frees what tomojax_step_load has allocated. */
void tomojax_step_free(tomojax_tables *tables);

/* Sets the memory to that before the first slot; its first condition is returned. */
int32_t tomojax_step_init(const tomojax_tables *tables, tomojax_state *state);

/* Runs one slot: `condition` is the one that the rig had, whichever was asked for, `lost`
 * the slots that were lost since the one before, `hurried` whether the cheaper method is to
 * answer, where the step has one. */
void tomojax_step(const tomojax_tables *tables, tomojax_state *state,
                  const tomojax_real *volts, int32_t condition, int32_t lost, int32_t hurried,
                  tomojax_output *out);

/* The image after a slot, in the method's unit; NaN for a slot that could not be used. */
void tomojax_step_image(const tomojax_tables *tables, const tomojax_state *state,
                        tomojax_real *image);

/* Uses another of the policies, from the next slot on. */
void tomojax_step_switch(tomojax_state *state, int32_t policy);

#ifdef __cplusplus
}
#endif
#endif
