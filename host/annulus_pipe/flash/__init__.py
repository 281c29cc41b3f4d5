"""Getting an image into a controller: reading and judging it, the boot loader it is written through, updating."""
