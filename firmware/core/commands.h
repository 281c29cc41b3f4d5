// What each command does. queries.c has those that change nothing, commands.c all others.

#ifndef ANNULUS_COMMANDS_H
#define ANNULUS_COMMANDS_H

#include "controller.h"

// Carry out a command that came over this line; its reply's payload.
void commands_execute(controller_t* self, uint8_t line, const command_t* command, uint8_t reply[PAYLOAD_MAX]);

// May this line's host change anything? The one that identified last, and knows what it says.
static inline bool commands_allowed(const controller_t* const self, const uint8_t line)
{
    return self->schema_ok && (line == self->session);
}

// A command each: its payload, and the reply's to be filled in.
void query_identify(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_ping(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_status(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_info(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_configuration(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_crash(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_health(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_hardware(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_reread(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);
void query_samples(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer);

#endif
