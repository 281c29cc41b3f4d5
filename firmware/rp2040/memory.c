// The three functions of libc the compiler and the core may call.

#include <stddef.h>
#include <stdint.h>
#include <string.h>

void* memcpy(void* restrict to, const void* restrict from, size_t size)
{
    uint8_t* out = to;
    for (const uint8_t* in = from; size > 0U; size--) {
        *out++ = *in++;
    }
    return to;
}

void* memmove(void* to, const void* from, size_t size)
{
    uint8_t* const out = to;
    const uint8_t* const in = from;
    if (out < in) {
        return memcpy(to, from, size);
    }
    while (size-- > 0U) {
        out[size] = in[size];
    }
    return to;
}

void* memset(void* to, int value, size_t size)
{
    uint8_t* out = to;
    while (size-- > 0U) {
        *out++ = (uint8_t)value;
    }
    return to;
}
