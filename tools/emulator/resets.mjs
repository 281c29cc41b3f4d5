// Which bit of RESETS holds which block (RP2040 datasheet 2.14), where the blocks are, and those that are always on.

export const RESET_BITS = { adc: 0, dma: 2, io: 5, qspi: 6, pads: 8, padsQspi: 9, pio0: 10, pio1: 11, pllSys: 12, pllUsb: 13, timer: 21, uart0: 22, usb: 24 };
export const RESET_OF = new Map([
  [0x40014, 'io'], [0x40018, 'qspi'], [0x4001c, 'pads'], [0x40020, 'padsQspi'], [0x40028, 'pllSys'], [0x4002c, 'pllUsb'],
  [0x40034, 'uart0'], [0x4004c, 'adc'], [0x40054, 'timer'], [0x50000, 'dma'], [0x50100, 'usb'], [0x50110, 'usb'], [0x50200, 'pio0'], [0x50300, 'pio1'],
]);
export const ALWAYS_ON = new Set([0x40008, 0x4000c, 0x40010, 0x40024, 0x40058, 0x40060, 0x18000]);
