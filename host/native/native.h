// What every loop starts from: how a function is opened to Python, and the names of types.
//
// A door is a function that annulus_pipe.numeric.native declares with the same arguments, in the same order; after them
// come the sizes of its arrays, by the letters that the declaration gives them. Python checks kinds, shapes and sizes
// of all arrays before the call, so a door's tables have the sizes that it is given; what is looked up by a value that
// an array holds is bounded where it is looked up. A door allocates nothing: room to work in is an argument.
#ifndef ANNULUS_NATIVE_H
#define ANNULUS_NATIVE_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define DOOR __attribute__((visibility("default")))
#define NOTHING ((double)NAN)  // where there is none
#define INLINE static inline __attribute__((always_inline))
// One copy, however often it is called: what runs once a frame is mostly waiting for its code to come from memory.
#define ONCE static __attribute__((noinline, noclone, unused))

INLINE int64_t least(const int64_t a, const int64_t b)
{
    return a < b ? a : b;
}

INLINE int64_t most(const int64_t a, const int64_t b)
{
    return a > b ? a : b;
}

// A value held between two limits; a NaN becomes the lower one.
INLINE double held(const double value, const double low, const double high)
{
    const double above = value > low ? value : low;
    return above < high ? above : high;
}

INLINE float held_f(const float value, const float low, const float high)
{
    const float above = value > low ? value : low;
    return above < high ? above : high;
}

// A whole number of a value that may be anything, NaN included: converting one that does not fit is undefined.
INLINE int64_t whole(const double value, const int64_t low, const int64_t high)
{
    return (int64_t)held(value, (double)low, (double)high);
}

INLINE int64_t bounded(const int64_t value, const int64_t low, const int64_t high)
{
    return most(low, least(value, high));
}

// A place at most one turn off, on a circle of that size: what % gives, without a division.
INLINE int64_t around(const int64_t place, const int64_t size)
{
    return place < 0 ? place + size : place >= size ? place - size : place;
}

#endif
