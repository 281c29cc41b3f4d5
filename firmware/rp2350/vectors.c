// Where the application is entered from outside. An RP2350 has more interrupts than the head of an image has room for
// (application.h): the loader starts by the head, and start.c points VTOR at the whole table, elsewhere in the image.

#include "../application.h"
#include "../rp2040/hardware.h"
#include "../rp2040/registers.h"

extern uint32_t stack_top[];

void reset_handler(uint32_t mark, uint32_t handover);  // start.c

typedef void (*vector_t)(void);

#define TOP_AND_EXCEPTIONS                                                                                             \
    [0] = (vector_t)(uintptr_t)stack_top, [1] = (vector_t)reset_handler, [2] = fault_handler, [3] = fault_handler,     \
    [4] = fault_handler, [5] = fault_handler, [6] = fault_handler, [7] = fault_handler, [11] = fault_handler,          \
    [12] = fault_handler, [14] = fault_handler, [15] = fault_handler

__attribute__((section(".vectors"), used)) static const vector_t head[APPLICATION_SIZE_AT / 4U] = {TOP_AND_EXCEPTIONS};

// On a multiple of its size, rounded up to a power of two (Armv8-M).
__attribute__((section(".vectors_all"), used, aligned(512))) static const vector_t vectors[16U + IRQS] = {
    TOP_AND_EXCEPTIONS,           [16 + IRQ_TIMER0] = alarm_handler,  [16 + IRQ_TIMER1] = stuck_handler,
    [16 + IRQ_USB] = usb_handler, [16 + IRQ_IO_BANK0] = pins_handler, [16 + IRQ_UART0] = serial_handler,
};
