// What each command does.

#ifndef ANNULUS_COMMANDS_H
#define ANNULUS_COMMANDS_H

#include "controller.h"

// Carry out a command; its reply's payload.
void commands_execute(controller_t* self, const command_t* command, uint8_t reply[PAYLOAD_MAX]);

#endif
