// A new application over the line, chunk by chunk. The flash it goes to is not the one that runs: whatever breaks off
// leaves nothing behind that could start.

#include "update.h"

#include "../application.h"
#include "../board.h"
#include "../ticks.h"
#include "messages.h"

void update_begin(update_t* const self, const uint32_t size, const uint32_t crc, const uint32_t now)
{
    if ((size != self->size) || (crc != self->crc)) {
        self->next = 0;
    }
    self->size = size;
    self->crc = crc;
    self->heard = now;
    self->under_way = true;
}

bool update_take(update_t* const self, const uint32_t offset, const uint8_t* const chunk, const uint32_t now,
                 uint8_t* const refusal)
{
    *refusal = UPDATE_REFUSAL_NOT_NOW;
    if (!self->under_way) {
        return false;
    }
    self->heard = now;
    if ((offset > self->next) || (offset % UPDATE_CHUNK_BYTES != 0U)) {
        *refusal = UPDATE_REFUSAL_INCOMPLETE;
        return false;
    }
    if ((offset == self->next) && (self->next < self->size)) {
        board_update_write(offset, chunk);
        self->next += UPDATE_CHUNK_BYTES;
    }
    return true;
}

// Vectors that lead into the application itself: one that was linked for another place would never start.
static bool belongs_here(const uint8_t* const application)
{
    static const char name[] = "annulus ";
    const uint8_t* at = application + APPLICATION_NAME_AT;
    for (uint32_t i = 0; i < sizeof name - 1U; i++) {
        if (*at++ != (uint8_t)name[i]) {
            return false;
        }
    }
    for (const uint8_t* board = board_name(); *board != 0U; board++) {
        if (*at++ != *board) {
            return false;
        }
    }
    return (*at == ' ') && board_update_starts_at(application_word(application + 4U));
}

bool update_finish(update_t* const self, uint8_t* const refusal)
{
    *refusal = UPDATE_REFUSAL_NOT_NOW;
    if (!self->under_way) {
        return false;
    }
    if (self->next < self->size) {
        *refusal = UPDATE_REFUSAL_INCOMPLETE;
        return false;
    }
    const uint8_t* const staged = board_update_staged();
    const bool whole = (application_word(staged + APPLICATION_SIZE_AT) == self->size) &&
                       application_is_whole(staged, UPDATE_MAX_BYTES) && (application_crc(staged) == self->crc);
    if (!whole || !belongs_here(staged)) {
        *refusal = whole ? UPDATE_REFUSAL_FOREIGN : UPDATE_REFUSAL_DAMAGED;
        self->next = 0;
        self->under_way = false;
        return false;
    }
    board_update_commit();
    return true;
}

void update_run(update_t* const self, const uint32_t now)
{
    if (self->under_way && (ticks_since(now, self->heard) > (int32_t)(UPDATE_SILENCE_MS * TICKS_PER_MS))) {
        self->under_way = false;
    }
}

void update_stop(update_t* const self)
{
    self->under_way = false;
}
