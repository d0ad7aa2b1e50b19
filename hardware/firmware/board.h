/* What example_rig.c needs of a board. board_host.c has it for a computer, simulated. */
#ifndef BOARD_H
#define BOARD_H

#include <stddef.h>
#include <stdint.h>

#ifndef ELECTRODES
#define ELECTRODES 64
#endif
#ifndef CONDITIONS /* rows of a table that there is room for */
#define CONDITIONS ELECTRODES
#endif
#ifndef SLOT_MICROSECONDS
#define SLOT_MICROSECONDS 100
#endif
#ifndef SETTLE_MICROSECONDS
#define SETTLE_MICROSECONDS 10
#endif

void board_begin(void);
uint32_t board_session(void);    /* another one at each start: random, or a flash count */
uint64_t micros(void);           /* never falls: widen a 32-bit timer in its interrupt */
void mux_ground(const uint8_t *closed); /* breaks the last, then grounds where not 0 */
int16_t adc_read(uint16_t channel);
int uart_read(void); /* the next byte from the host, -1 where there is none */
size_t uart_write_some(const uint8_t *bytes, size_t count); /* returns at once */
void board_idle(void); /* while there is nothing to do: sleep to the next interrupt */

#endif
