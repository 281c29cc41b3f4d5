// Second stage: the 256 bytes the boot ROM copies to RAM and enters. Makes the flash readable in place with the plain
// 03h read every serial flash knows, at clk_sys / 4 (25 MHz), then enters the vector table behind it. tools: uf2.py puts
// the CRC32 into the last word.

    .file "boot2.S"
    .syntax unified
    .cpu cortex-m0plus
    .thumb
    .section .boot2, "ax"
    .global boot2
    .type boot2, %function
boot2:
    push {lr}
    ldr r3, =0x18000000       // XIP_SSI
    movs r1, #0
    str r1, [r3, #0x08]       // SSIENR: off while it is set up
    movs r1, #4
    str r1, [r3, #0x14]       // BAUDR
    ldr r1, =0x001F0300       // CTRLR0: 32-bit frames, read after command and address, one bit wide
    str r1, [r3, #0x00]
    ldr r1, =0x03000218       // SPI_CTRLR0: command 03h of 8 bits, address of 24
    ldr r0, =0x180000F4
    str r1, [r0]
    movs r1, #0
    str r1, [r3, #0x04]       // CTRLR1: one frame a read
    movs r1, #1
    str r1, [r3, #0x08]       // SSIENR: on
    pop {r0}
    cmp r0, #0
    beq enter
    bx r0                     // called by a program that had the flash for itself for a while
enter:
    ldr r0, =0x10000100
    ldr r1, =0xE000ED08       // VTOR
    str r0, [r1]
    ldmia r0, {r0, r1}
    msr msp, r0
    bx r1
    .ltorg
