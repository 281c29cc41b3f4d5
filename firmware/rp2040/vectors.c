// Where the application is entered from outside. This is the head of the image (application.h).

#include "../application.h"
#include "hardware.h"
#include "registers.h"

extern uint32_t stack_top[];

void reset_handler(uint32_t mark, uint32_t handover);  // start.c

typedef void (*vector_t)(void);

__attribute__((section(".vectors"), used)) static const vector_t vectors[APPLICATION_SIZE_AT / 4U] = {
    [0] = (vector_t)(uintptr_t)stack_top,
    [1] = (vector_t)reset_handler,
    [2] = fault_handler,
    [3] = fault_handler,
    [11] = fault_handler,
    [14] = fault_handler,
    [15] = fault_handler,
    [16 + IRQ_TIMER0] = alarm_handler,
    [16 + IRQ_TIMER1] = stuck_handler,
    [16 + IRQ_USB] = usb_handler,
    [16 + IRQ_IO_BANK0] = pins_handler,
    [16 + IRQ_UART0] = serial_handler,
};
