// A new application over the line, chunk by chunk. The flash it goes to is not the one that runs: whatever breaks off
// leaves nothing behind that could start.

#include "update.h"

#include <string.h>

#include "../application.h"
#include "../board.h"
#include "../ticks.h"
#include "messages.h"

_Static_assert(BOARD_UPDATE_HEAD_AT == APPLICATION_SIZE_AT, "the head begins with the size");

// What was written last is read back: the CRC is that of the flash, not of the line. The last word of the application
// is no part of it.
static void read_back(update_t* const self)
{
    if (self->read < self->next) {
        uint8_t kept[UPDATE_CHUNK_BYTES];
        if (self->read == BOARD_UPDATE_HEAD_AT) {
            memcpy(kept, self->head, sizeof kept);
        } else {
            board_update_read(self->read, kept, sizeof kept);
        }
        const uint32_t left = (self->size - 4U > self->read) ? self->size - 4U - self->read : 0U;
        self->sum = crc32_add(self->sum, kept, (left < sizeof kept) ? left : sizeof kept);
        self->read += UPDATE_CHUNK_BYTES;
    }
}

static void begin_anew(update_t* const self)
{
    self->next = 0;
    self->read = 0;
    self->sum = CRC32_BEGIN;
}

void update_begin(update_t* const self, const uint32_t size, const uint32_t crc, const uint32_t now)
{
    if ((size != self->size) || (crc != self->crc)) {
        begin_anew(self);
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
    read_back(self);
    if ((offset > self->next) || (offset % UPDATE_CHUNK_BYTES != 0U)) {
        *refusal = UPDATE_REFUSAL_INCOMPLETE;
        return false;
    }
    if ((offset == self->next) && (self->next < self->size)) {
        if (offset == BOARD_UPDATE_HEAD_AT) {
            memcpy(self->head, chunk, sizeof self->head);
        } else {
            board_update_write(offset, chunk);
        }
        self->next += UPDATE_CHUNK_BYTES;
    }
    return true;
}

// Vectors that lead into the application itself: one that was linked for another place would never start.
static bool belongs_here(const uint8_t* const vectors, const uint8_t* at)
{
    static const char name[] = "annulus ";
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
    return (*at == ' ') && board_update_starts_at(application_word(vectors + 4U));
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
    read_back(self);
    uint8_t vectors[8];
    uint8_t last[4];
    board_update_read(0U, vectors, sizeof vectors);
    const uint8_t* const head = self->head;
    board_update_read(self->size - 4U, last, sizeof last);
    const bool whole = application_fits(self->size, UPDATE_MAX_BYTES) && (application_word(head) == self->size) &&
                       (application_word(head + APPLICATION_NAME_AT - APPLICATION_SIZE_AT) == APPLICATION_NAME_START) &&
                       (application_word(last) == self->crc) && (crc32_end(self->sum) == self->crc);
    if (!whole || !belongs_here(vectors, head + APPLICATION_NAME_AT - APPLICATION_SIZE_AT)) {
        *refusal = whole ? UPDATE_REFUSAL_FOREIGN : UPDATE_REFUSAL_DAMAGED;
        begin_anew(self);
        self->under_way = false;
        return false;
    }
    board_update_commit(self->crc, head);
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
