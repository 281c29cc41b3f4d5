// The flash's commands, given by hand over the RP2350's QMI in direct mode (datasheet 12.14). Included by
// ../rp2040/flash.h only. One bit wide, which every serial flash knows; the boot ROM leaves the flash where it takes
// them. The flash is selected by hand: a pause within a transaction does no harm, so its length has no limit.
//
// While direct mode is on nothing can be read in place: whoever runs this runs from RAM.

#ifndef ANNULUS_FLASH_BUS_H
#define ANNULUS_FLASH_BUS_H

#define QMI_ENABLE (1U << 0)
#define QMI_BUSY (1U << 1)
#define QMI_SELECT (1U << 2)
#define QMI_RECEIVED_NONE (1U << 16)
#define QMI_CLOCK (4U << 22)  // clk_sys / 4: 25 MHz, for a 03h of any flash
#define QMI_DRIVE (1U << 19)  // SD0, from here

static inline __attribute__((always_inline)) void flash_select(void)
{
    REGISTER(QMI_DIRECT_CSR) = QMI_CLOCK | QMI_ENABLE;
    REGISTER(QMI_DIRECT_CSR) = QMI_CLOCK | QMI_ENABLE | QMI_SELECT;
}

#define FLASH_PATIENCE 10000U  // looks; a byte takes 0.3 us
static inline __attribute__((always_inline)) void flash_wait(const uint32_t bit)
{
    for (uint32_t looks = 0; ((REGISTER(QMI_DIRECT_CSR) & bit) != 0U) && (looks < FLASH_PATIENCE); looks++) {
    }
}

static inline __attribute__((always_inline)) void flash_release(void)
{
    flash_wait(QMI_BUSY);
    REGISTER(QMI_DIRECT_CSR) = QMI_CLOCK | QMI_ENABLE;
    REGISTER(QMI_DIRECT_CSR) = QMI_CLOCK;
}

// A byte out, and the one that comes in meanwhile.
static inline __attribute__((always_inline)) uint32_t flash_byte(const uint32_t out)
{
    REGISTER(QMI_DIRECT_TX) = QMI_DRIVE | out;
    flash_wait(QMI_RECEIVED_NONE);
    return REGISTER(QMI_DIRECT_RX) & 0xFFU;
}

static inline __attribute__((always_inline)) void flash_command(const uint32_t command, const uint32_t at)
{
    flash_select();
    (void)flash_byte(command);
    for (uint32_t shift = 24U; shift > 0U; shift -= 8U) {
        (void)flash_byte((at >> (shift - 8U)) & 0xFFU);
    }
}

static inline __attribute__((always_inline)) bool flash_is_busy(void)
{
    flash_select();
    (void)flash_byte(FLASH_STATUS);
    const uint32_t status = flash_byte(0U);
    flash_release();
    return (status & FLASH_BUSY) != 0U;
}

static inline __attribute__((always_inline)) void flash_write_enable(void)
{
    flash_select();
    (void)flash_byte(FLASH_WRITE_ENABLE);
    flash_release();
}

// Begin to erase a sector: 45 ms, 400 at worst (W25Q32JV).
static inline __attribute__((always_inline)) void flash_erase(const uint32_t at)
{
    flash_write_enable();
    flash_command(FLASH_ERASE_SECTOR, at);
    flash_release();
}

// Begin to program words of one page, FLASH_PROGRAM_MAX bytes at most: 0.4 ms, 3 at worst.
static inline __attribute__((always_inline)) void flash_program(const uint32_t at, const uint32_t* const words,
                                                                const uint32_t count)
{
    flash_write_enable();
    flash_command(FLASH_PROGRAM, at);
    for (uint32_t i = 0; i < 4U * count; i++) {
        (void)flash_byte((words[i / 4U] >> (8U * (i % 4U))) & 0xFFU);
    }
    flash_release();
}

// Words of it, FLASH_READ_MAX bytes at most.
static inline __attribute__((always_inline)) void flash_read(const uint32_t at, uint32_t* const words,
                                                             const uint32_t count)
{
    flash_command(FLASH_READ, at);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t word = 0;
        for (uint32_t shift = 0; shift < 32U; shift += 8U) {
            word |= flash_byte(0U) << shift;
        }
        words[i] = word;
    }
    flash_release();
}

#endif
