// What the light of a frame is told by: how often each grey level is there, and what each brightness has of each
// colour.

#include <string.h>

#include "native.h"

#define LEVELS 256                  // grey levels of a channel
#define BRIGHTNESSES (3 * 255 + 1)  // sums of three

// Of some pixels (n, m, blue green red): `tops` (sectors, levels), how often a pixel of a sector has a level for its
// strongest channel; `seconds` (levels), of its second. `light` (3), sums of each channel where it is above `faint`;
// `squares` (3, brightnesses), sums of its squares, by the sum of what is above it of all three.
DOOR void frame_light(const uint8_t* const some, const uint8_t* const sector, const int64_t faint, int64_t* const tops,
                      int64_t* const seconds, int64_t* const light, int64_t* const squares, const int64_t n,
                      const int64_t m, const int64_t s)
{
    memset(tops, 0, (size_t)(s * LEVELS) * sizeof *tops);
    memset(seconds, 0, LEVELS * sizeof *seconds);
    memset(light, 0, 3 * sizeof *light);
    memset(squares, 0, 3 * BRIGHTNESSES * sizeof *squares);
    for (int64_t k = 0; k < n * m; k++) {
        const int64_t blue = some[3 * k], green = some[3 * k + 1], red = some[3 * k + 2];
        const int64_t larger = most(blue, green), smaller = least(blue, green);
        tops[least(sector[k], s - 1) * LEVELS + most(larger, red)]++;
        seconds[most(smaller, least(larger, red))]++;
        const int64_t b = blue > faint ? blue : 0, g = green > faint ? green : 0, r = red > faint ? red : 0;
        light[0] += b;
        light[1] += g;
        light[2] += r;
        int64_t* const square = squares + b + g + r;
        square[0] += b * b;
        square[BRIGHTNESSES] += g * g;
        square[2 * BRIGHTNESSES] += r * r;
    }
}
