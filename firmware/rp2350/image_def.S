// What the boot ROM looks for in the first 4 KiB of flash before it starts anything (datasheet 5.9.5): an executable,
// Arm, Secure, for an RP2350; no signature, no hash. It enters by the vector table at the very start.

    .section .image_def, "a"
    .word 0xFFFFDED3
    .byte 0x42, 0x01        // IMAGE_TYPE, one word
    .hword 0x1021           // RP2350, Arm; Secure; executable
    .byte 0xFF              // the last item: one word before it
    .hword 0x0001
    .byte 0x00
    .word 0                 // the next block is this one
    .word 0xAB123579
