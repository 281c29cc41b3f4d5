// The flash's commands, given by hand over the RP2040's SSI (datasheet 4.10). Included by flash.h only.
//
// A command is put into the FIFO before the flash is selected; it stays selected until the FIFO is empty. So a
// transaction has 16 frames at most, and no gap.

#ifndef ANNULUS_FLASH_BUS_H
#define ANNULUS_FLASH_BUS_H

// One transaction begins: `count` frames of `bits`.
static inline __attribute__((always_inline)) void flash_select(const uint32_t bits)
{
    REGISTER(SSI_ENABLE) = 0U;
    REGISTER(SSI_CONTROL0) = (bits - 1U) << 16;  // as many out as in; at 25 MHz, as boot2.S left it
    REGISTER(SSI_SELECT) = 0U;
    REGISTER(SSI_ENABLE) = 1U;
}

// And ends: what came in for the last `wanted` of its frames. A FIFO that never fills leaves ones, as an absent flash.
#define FLASH_PATIENCE 10000U  // looks; a transaction takes 21 us at most
static inline __attribute__((always_inline)) void flash_take(const uint32_t count, uint32_t* const in,
                                                             const uint32_t wanted)
{
    REGISTER(SSI_SELECT) = 1U;
    for (uint32_t looks = 0; (REGISTER(SSI_RECEIVED) < count) && (looks < FLASH_PATIENCE); looks++) {
    }
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t frame = REGISTER(SSI_DATA);
        if (i + wanted >= count) {
            in[i + wanted - count] = frame;
        }
    }
}

static inline __attribute__((always_inline)) bool flash_is_busy(void)
{
    uint32_t status = 0;
    flash_select(8U);
    REGISTER(SSI_DATA) = FLASH_STATUS;
    REGISTER(SSI_DATA) = 0U;
    flash_take(2U, &status, 1U);
    return (status & FLASH_BUSY) != 0U;
}

static inline __attribute__((always_inline)) void flash_write_enable(void)
{
    uint32_t nothing;
    flash_select(8U);
    REGISTER(SSI_DATA) = FLASH_WRITE_ENABLE;
    flash_take(1U, &nothing, 0U);
}

// Begin to erase a sector: 45 ms, 400 at worst (W25Q16JV).
static inline __attribute__((always_inline)) void flash_erase(const uint32_t at)
{
    uint32_t nothing;
    flash_write_enable();
    flash_select(32U);
    REGISTER(SSI_DATA) = ((uint32_t)FLASH_ERASE_SECTOR << 24) | at;
    flash_take(1U, &nothing, 0U);
}

static inline __attribute__((always_inline)) uint32_t flash_swapped(const uint32_t word)
{
    return (word >> 24) | ((word >> 8) & 0xFF00U) | ((word << 8) & 0xFF0000U) | (word << 24);
}

// Begin to program words of one page, FLASH_PROGRAM_MAX bytes at most: 0.4 ms, 3 at worst.
static inline __attribute__((always_inline)) void flash_program(const uint32_t at, const uint32_t* const words,
                                                                const uint32_t count)
{
    uint32_t nothing;
    flash_write_enable();
    flash_select(32U);
    REGISTER(SSI_DATA) = ((uint32_t)FLASH_PROGRAM << 24) | at;
    for (uint32_t i = 0; i < count; i++) {
        REGISTER(SSI_DATA) = flash_swapped(words[i]);
    }
    flash_take(1U + count, &nothing, 0U);
}

// Words of it, FLASH_READ_MAX bytes at most.
static inline __attribute__((always_inline)) void flash_read(const uint32_t at, uint32_t* const words,
                                                             const uint32_t count)
{
    flash_select(32U);
    REGISTER(SSI_DATA) = ((uint32_t)FLASH_READ << 24) | at;
    for (uint32_t i = 0; i < count; i++) {
        REGISTER(SSI_DATA) = 0U;
    }
    flash_take(1U + count, words, count);
    for (uint32_t i = 0; i < count; i++) {
        words[i] = flash_swapped(words[i]);
    }
}

#endif
