// Colours of some cells of a mosaic: of what a colour sensor gives, one colour a cell.
//
// A colour that a cell has not is the mean of the cells next to it that have it, as OpenCV makes it of all cells.

#include "native.h"

// From every `every`-th cell of every such row, from the middle of the first; all lie in an even row and column, with a
// cell on each side. `green_first`: these cells are green. `red_first`: what is in their row, or they themselves, is
// red.
DOOR void mosaic_thinned(const uint8_t* const cells, const int64_t every, const bool green_first, const bool red_first,
                         uint8_t* const out, const int64_t h, const int64_t w, const int64_t n, const int64_t m)
{
    const int64_t first = every / 2;
    for (int64_t y = 0; y < n; y++) {
        const uint8_t* const row = cells + most(least(first + y * every, h - 2), 1) * w;
        for (int64_t x = 0; x < m; x++) {
            const uint8_t* const cell = row + most(least(first + x * every, w - 2), 1);
            const int beside = cell[-1] + cell[1], above = cell[-w] + cell[w];
            const int askew = cell[-w - 1] + cell[-w + 1] + cell[w - 1] + cell[w + 1];
            const int green = green_first ? cell[0] : (beside + above + 2) >> 2;
            const int one = green_first ? (beside + 1) >> 1 : cell[0];
            const int other = green_first ? (above + 1) >> 1 : (askew + 2) >> 2;
            uint8_t* const pixel = out + 3 * (y * m + x);
            pixel[0] = (uint8_t)(red_first ? other : one);
            pixel[1] = (uint8_t)green;
            pixel[2] = (uint8_t)(red_first ? one : other);
        }
    }
}
