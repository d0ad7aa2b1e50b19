/* Runs test vectors on a Cortex-M7 board (QEMU's mps2-an500) and counts what a slot takes.
 *
 * The tables and the vectors are part of the program. It prints slots, how many differ from
 * JAX's program, SysTick's counts for each slot and the bytes of stack that were used.
 * QEMU runs one instruction in a nanosecond of its own time (-icount shift=0), and SysTick
 * counts 25 MHz: 40 instructions each. */
#include <stdio.h>
#include <string.h>
#include "tomojax_step.h"

#define SYSTICK ((volatile uint32_t *)0xE000E010)
#define WHOLE 0xFFFFFFu

/* From the linker: the files, and the ends of data and stack. */
extern const unsigned char tables_begin[], tables_end[], vectors_begin[], vectors_end[];
extern uint32_t stack_bottom[], stack_top[];
extern void initialise_monitor_handles(void);
extern uint32_t bss_begin[], bss_end[];

int main(void)
{
    static tomojax_state state;
    static tomojax_output out, expected;
    static tomojax_real volts[TOMOJAX_ELECTRODES];
    const unsigned char *at = vectors_begin;
    const size_t row = sizeof state.numbers + sizeof state.whole + sizeof volts +
                       3 * sizeof(int32_t) + offsetof(tomojax_output, count) + 12;
    unsigned long slots = 0, differ = 0, ticks = 0, most = 0, used = 0;
    int32_t slot[3];
    tomojax_tables tables;
    const char *wrong = tomojax_step_use(tables_begin, tables_end - tables_begin, &tables);
    if (wrong != NULL) {
        printf("%s\n", wrong);
        return 2;
    }
    for (uint32_t *p = stack_bottom; p < (uint32_t *)&used - 64; p++) *p = 0xA5A5A5A5;
    SYSTICK[1] = WHOLE;
    SYSTICK[2] = 0;
    SYSTICK[0] = 5;
    for (; at + row <= vectors_end; slots++) {
#define TAKE(to, size) (memcpy(to, at, size), at += (size))
        TAKE(state.numbers, sizeof state.numbers);
        TAKE(state.whole, sizeof state.whole);
        TAKE(volts, sizeof volts);
        TAKE(slot, sizeof slot);
        TAKE(&expected, offsetof(tomojax_output, count));
        TAKE(&expected.count, 12);
        const uint32_t before = SYSTICK[2];
        tomojax_step(&tables, &state, volts, slot[0], slot[1], slot[2], &out);
        const uint32_t took = (before - SYSTICK[2]) & WHOLE;
        ticks += took;
        if (took > most) most = took;
        differ += out.count != expected.count || out.flags != expected.flags ||
                  out.next_condition != expected.next_condition;
    }
    uint32_t *p = stack_bottom;
    while (*p == 0xA5A5A5A5) p++;
    used = (unsigned long)((char *)stack_top - (char *)p);
    printf("%lu slots: %lu differ, %lu instructions, %lu at most, %lu bytes of stack\n", slots,
           differ, 40 * (ticks / slots), 40 * most, used);
    return 0;
}

const char told[] = "the processor met a fault\n";

static void stop(void) /* angel_SWIreason_ReportException: the application ended */
{
    fflush(stdout);
    for (;;) __asm volatile("mov r0, #0x18; ldr r1, =0x20026; bkpt 0xab" ::: "r0", "r1");
}

void _init(void) {}
void _fini(void) {}

void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xF << 20; /* floating point on */
    __asm volatile("dsb; isb");
    memset(bss_begin, 0, (char *)bss_end - (char *)bss_begin);
    initialise_monitor_handles();
    main();
    stop();
}

void fault(void)
{
    __asm volatile("mov r0, #4; ldr r1, =told; bkpt 0xab" ::: "r0", "r1");
    stop();
}

__attribute__((section(".vectors"), used)) void *const vectors[16] = {
    stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault,
    (void *)fault};

__asm(".section .rodata\n.balign 64\n.global tables_begin\ntables_begin:\n"
      ".incbin \"step.tables\"\n.global tables_end\ntables_end:\n.balign 4\n"
      ".global vectors_begin\nvectors_begin:\n.incbin \"few.bin\"\n"
      ".global vectors_end\nvectors_end:\n.text\n");
