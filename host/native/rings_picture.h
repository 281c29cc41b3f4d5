// One pixel of a frame, whether it came in colours or as the mosaic that a sensor gives: a colour that a cell has not
// is the mean of its neighbours that have it, as OpenCV's bilinear demosaicing makes it, to the bit.
#ifndef ANNULUS_RINGS_PICTURE_H
#define ANNULUS_RINGS_PICTURE_H

#include "native.h"

#define IN_COLOURS 3  // bytes a pixel: blue, green, red; of a mosaic it is 1

typedef struct {
    const uint8_t* data;
    int64_t width, height;
    int64_t phase;  // of a mosaic: 2 * row + column, modulo 2, of its red cells
} picture_t;

typedef struct {
    uint8_t blue, green, red;
} pixel_t;

INLINE uint8_t mean_of_two(const uint8_t a, const uint8_t b)
{
    return (uint8_t)((a + b + 1) >> 1);
}

// (a + b + c + d + 2) / 4 by means of two, each rounded up: where both rounded and the sum is odd, once too often.
INLINE uint8_t mean_of_four(const uint8_t a, const uint8_t b, const uint8_t c, const uint8_t d)
{
    const uint8_t p = mean_of_two(a, b), q = mean_of_two(c, d);
    return (uint8_t)(mean_of_two(p, q) - ((((a ^ b) | (c ^ d)) & (p ^ q)) & 1));
}

INLINE pixel_t pixel_of(const picture_t* const picture, const int64_t x, const int64_t y, const bool mosaic)
{
    const int64_t w = picture->width;
    if (!mosaic) {
        const uint8_t* const at = picture->data + IN_COLOURS * (y * w + x);
        return (pixel_t){at[0], at[1], at[2]};
    }
    // the margin repeats what is beside it; a picture of fewer than three rows or columns is never asked (rings.polar)
    const int64_t column = bounded(x, 1, w - 2), row = bounded(y, 1, picture->height - 2);
    const uint8_t* const at = picture->data + row * w + column;
    const uint8_t across = mean_of_two(at[-1], at[1]), along = mean_of_two(at[-w], at[w]);
    const uint8_t cross = mean_of_four(at[-w], at[w], at[-1], at[1]);
    const uint8_t askew = mean_of_four(at[-w - 1], at[-w + 1], at[w - 1], at[w + 1]);
    const bool red_column = ((column ^ picture->phase) & 1) == 0, red_row = ((row ^ (picture->phase >> 1)) & 1) == 0;
    const uint8_t of_red_row = red_column ? *at : across, of_blue_row = red_column ? along : askew;
    const uint8_t blue_there = red_column ? across : *at, blue_off = red_column ? askew : along;
    return (pixel_t){red_row ? blue_off : blue_there, red_row == red_column ? cross : *at,
                     red_row ? of_red_row : of_blue_row};
}

#endif
