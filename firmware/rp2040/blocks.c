// What several files ask of pads, PIO and DMA.

#include "hardware.h"
#include "registers.h"

void pin_use(const uint32_t pin, const uint32_t function, const uint32_t pad)
{
    REGISTER(PAD(pin)) = pad;
    REGISTER(GPIO_CTRL(pin)) = function;
}

void pio_load(const uint32_t pio, const uint32_t first, const uint16_t* const program, const uint32_t length)
{
    for (uint32_t i = 0; i < length; i++) {
        REGISTER(PIO_MEMORY(pio, first + i)) = program[i];
    }
}

// With the one it is chained to, if there is one: an aborted channel may trigger that (erratum RP2350-E5).
void dma_stop(const uint32_t channel)
{
    CLEAR_BITS(DMA_CTRL(channel)) = DMA_ENABLE;
    CLEAR_BITS(DMA_CTRL(DMA_CHAINED(REGISTER(DMA_CTRL(channel))))) = DMA_ENABLE;
    REGISTER(DMA_ABORT) = 1U << channel;
    while ((REGISTER(DMA_CTRL(channel)) & DMA_BUSY) != 0U) {
    }
}
