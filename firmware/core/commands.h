// What each command does.

#ifndef ANNULUS_COMMANDS_H
#define ANNULUS_COMMANDS_H

#include "controller.h"

// Carry out a command that came over this line; its reply's payload.
void commands_execute(controller_t* self, uint8_t line, const command_t* command, uint8_t reply[PAYLOAD_MAX]);

#endif
