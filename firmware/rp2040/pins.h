// What hangs on which pin of the Pico; the same table as in ../README.md.

#ifndef ANNULUS_PINS_H
#define ANNULUS_PINS_H

enum {
    PIN_UART_TX = 0,
    PIN_UART_RX = 1,
    PIN_SYNC = 2,
    PIN_PROJECTOR = 3,  // and the LED next to it: one state machine drives both
    PIN_LED = 4,
    PIN_MICROWAVE = 5,
    PIN_TRIGGER = 6,
    PIN_INTERLOCK = 7,
    PIN_STEP = 8,
    PIN_DIRECTION = 9,
    PIN_ENABLE = 10,
    PIN_ODOMETER_A = 14,  // and B next to it
    PIN_ODOMETER_B = 15,
    PIN_STATUS = 25,
};

#endif
