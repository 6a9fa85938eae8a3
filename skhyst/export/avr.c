/* An ATmega2560 for firmware that is given here, emulated by simavr. What the firmware writes to
   GPIOR0 goes to the standard output. A write to GPIOR1 asks for a byte in GPIOR2: 0, of the
   standard input; 2 to 9, of the instructions and the cycles since the last write of 1. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_io.h>

enum { GPIOR0 = 0x3e, GPIOR1 = 0x4a, GPIOR2 = 0x4b };

static uint32_t instructions, since[2];

static void quiet(avr_t *avr, const int level, const char *text, va_list of)
{
    (void)avr, (void)level, (void)text, (void)of;
}

static void told(avr_t *avr, avr_io_addr_t at, uint8_t value, void *of)
{
    (void)avr, (void)at, (void)of;
    putchar(value);
    fflush(stdout);
}

static void asked(avr_t *avr, avr_io_addr_t at, uint8_t value, void *of)
{
    const uint32_t now[2] = {instructions, (uint32_t)avr->cycle};
    (void)at, (void)of;
    if (value == 0) {
        const int byte = getchar();
        avr->data[GPIOR2] = (uint8_t)byte;
        avr->state = byte == EOF ? cpu_Done : avr->state;
    } else if (value == 1) {
        memcpy(since, now, sizeof now);
    } else {
        static uint32_t taken[2];
        if (value == 2) {
            taken[0] = now[0] - since[0];
            taken[1] = now[1] - since[1];
        }
        avr->data[GPIOR2] = (uint8_t)(taken[(value - 2) / 4] >> 8 * ((value - 2) % 4));
    }
}

int main(int n, char **given)
{
    elf_firmware_t firmware = {{0}};
    avr_t *avr;
    avr_global_logger_set(quiet); /* which would write to the standard output */
    avr = avr_make_mcu_by_name("atmega2560");
    if (n != 2 || avr == NULL || elf_read_firmware(given[1], &firmware) != 0) {
        return 1;
    }
    avr_init(avr);
    avr_load_firmware(avr, &firmware);
    avr_register_io_write(avr, GPIOR0, told, NULL);
    avr_register_io_write(avr, GPIOR1, asked, NULL);
    do {
        avr->run_cycle_count = 1; /* one instruction */
        avr_run(avr);
        instructions++;
    } while (avr->state != cpu_Done && avr->state != cpu_Crashed);
    return 0;
}
