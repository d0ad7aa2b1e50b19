/* board.h on a computer with POSIX: standard input is the line, voltages are made up. */
#define _POSIX_C_SOURCE 200809L
#include "board.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

static int grounded; /* the numbers of all grounded electrodes, added */

void board_begin(void)
{
    alarm(120); /* whoever started it may have been killed */
    fcntl(0, F_SETFL, fcntl(0, F_GETFL) | O_NONBLOCK);
}

uint32_t board_session(void)
{
    uint32_t session = (uint32_t)getpid();
    int random = open("/dev/urandom", O_RDONLY);
    if (random >= 0 && read(random, &session, sizeof session) < 0)
        session = (uint32_t)time(NULL);
    if (random >= 0)
        close(random);
    return session;
}

uint64_t micros(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

void mux_ground(const uint8_t *closed)
{
    grounded = 0;
    for (int k = 0; k < ELECTRODES; k++)
        grounded += closed[k] ? k : 0;
}

int16_t adc_read(uint16_t channel) { return (int16_t)(100 * grounded + channel - 9000); }

int uart_read(void)
{
    uint8_t byte;
    return read(0, &byte, 1) == 1 ? byte : -1;
}

size_t uart_write_some(const uint8_t *bytes, size_t count)
{
    ssize_t sent = write(0, bytes, count);
    if (sent < 0 && errno != EAGAIN && errno != EINTR)
        exit(0); /* nobody holds the other end */
    return sent < 0 ? 0 : (size_t)sent;
}

void board_idle(void)
{
    struct timespec some = {0, 50000};
    nanosleep(&some, NULL);
}
