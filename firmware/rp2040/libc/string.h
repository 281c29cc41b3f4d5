// As much of libc as the core uses; see ../memory.c.

#ifndef ANNULUS_STRING_H
#define ANNULUS_STRING_H

#include <stddef.h>

void* memcpy(void* restrict to, const void* restrict from, size_t size);
void* memmove(void* to, const void* from, size_t size);
void* memset(void* to, int value, size_t size);

#endif
