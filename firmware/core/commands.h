// What each command does. queries.c has those that change nothing, commands.c all others; what the schema says of them
// (layout, range, needs) is in dispatch.c, which is generated.

#ifndef ANNULUS_COMMANDS_H
#define ANNULUS_COMMANDS_H

#include "controller.h"

// May the host whose command is being carried out change anything? The one that identified last, and knows what it
// says.
static inline bool commands_allowed(const controller_t* const self)
{
    return self->schema_ok && (self->asking == self->session);
}

// STATUS_OK, or why the command being carried out is refused: a field out of range (`range`: its index, or RANGE_OK),
// or what it NEEDS_* is not there. `detail` goes with it.
uint8_t commands_refusal(const controller_t* self, uint8_t needs, uint8_t range, uint8_t* detail);

#endif
