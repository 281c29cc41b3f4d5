// A new application over the line, chunk by chunk. It is kept beside the running one; only a whole one is started.

#ifndef ANNULUS_UPDATE_H
#define ANNULUS_UPDATE_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

typedef struct {
    bool under_way;  // nothing can be armed or moved meanwhile
    uint32_t size;   // of what is coming, or broke off
    uint32_t crc;
    uint32_t next;   // offset of the chunk that is due
    uint32_t read;   // so much of it was read back from the flash
    uint32_t sum;    // CRC-32 of that, not yet ended
    uint32_t heard;  // tick of the last chunk
    uint8_t
        head[UPDATE_CHUNK_BYTES];  // size and name: written last, so that nothing refused or broken off is ever whole
} update_t;

// Begin, or go on where the same one broke off.
void update_begin(update_t* self, uint32_t size, uint32_t crc, uint32_t now);

// UPDATE_REFUSAL_* in `refusal` when false. While the board writes what came before, none of these is called.
bool update_take(update_t* self, uint32_t offset, const uint8_t* chunk, uint32_t now, uint8_t* refusal);

// Is it whole, and ours? Then it is what starts next.
bool update_finish(update_t* self, uint8_t* refusal);

// Once a round: a host that says nothing has given up.
void update_run(update_t* self, uint32_t now);

// Whoever identifies begins anew; the same update can be gone on with.
void update_stop(update_t* self);

#endif
