// The twin's renderer: how a row of a frame is drawn, in stretches of pixels that one struct holds every value of.
//
// A ray leaves the camera through each pixel (twin_rays), meets the wall (twin_walls, or twin_course where the pipe has
// several pieces), gets what the lamps send there (twin_lights, and what lets it through: twin_slits, twin_fringes),
// and what comes back is made grey levels of (twin_draw). A step is a loop over a stretch without a branch, in float,
// so that a vector takes it on any processor; what cannot be (a march along one ray, a look-up) is a loop of its own.
#ifndef ANNULUS_TWIN_H
#define ANNULUS_TWIN_H

#include <math.h>
#include <string.h>

#include "native.h"

enum { PIXELS = 128 };  // of a stretch at most: all its values lie in the nearest cache
enum { LANES = 16 };    // loops go on to a whole number of these: no vector has more, and none is left half full
enum { ROOM = PIXELS + LANES };

// Values of pixels u0 .. u0 + n of row v. Those beyond n are of no pixel: finite, and never drawn.
typedef struct {
    int64_t n, full;                              // pixels; the same in whole lanes
    int64_t v, u0;                                // the row, and the first pixel's place in it
    const float *ray_x, *ray_y;                   // unit, in the camera's frame
    float spread[ROOM];                           // see ray_table of twin/rays.py; 0 where the lens sees nothing
    float start_x[ROOM], start_y[ROOM];           // mm, pipe frame: of rays that start apart
    float start_z[ROOM];                          //
    float way_x[ROOM], way_y[ROOM], way_z[ROOM];  // unit, pipe frame
    float plain[ROOM], range[ROOM];               // mm, to the plain cylinder, to the wall; in a course chainage, range
    float x[ROOM], y[ROOM], z[ROOM];              // mm, where the wall is met
    float nx[ROOM], ny[ROOM], nz[ROOM];           // out of the pipe there; unit, or shorter for what arrives aslant
    float open[ROOM];                             // part of the projector's light that gets there
    float column[ROOM];                           // of the wall's map
    float paint[ROOM];                            // above 0 where there is any; in a course how bright the piece is
    float view[ROOM];                             // part of the light that gets back, through water
    float at[ROOM], lit[ROOM];                    // cosine to the projector's axis; its light without a slide
    float level[ROOM];                            // all light
    int32_t mark[ROOM];                           // whatever the step in hand looks up
} Stretch;

typedef struct {
    float rotation[9];  // pipe to camera
    float station[3];   // mm
} Eye;

// A bilinear map of the wall's deviation, mm, with a column to spare before the first and three after the last.
typedef struct {
    const float* deviation;
    int64_t rows, pitch;
} Map;

// A wall of one piece; tiles are blocks of the map's cells.
typedef struct {
    float radius, z0, rows_a_mm, tiles_a_row, tiles_a_column;
} WallNumbers;

typedef struct {
    WallNumbers numbers;
    float columns, columns_a_rad;  // of the map, once round
    Map map;
    int64_t tiles, tile_columns;
    const float *low, *high;            // bounds of the deviation in a tile, mm
    const float *near_low, *near_high;  // bounds of what a ray to the tile may meet on its way
    const uint8_t* kind;                // bits, see twin_walls.c
} Wall;

// The projector's light in one frame.
typedef struct {
    float lit[4];       // u, v, inner, outer (px): pixels outside of that ring get none of it
    float centre[6];    // the point it comes from and its axis, pipe frame
    float power;        //
    float rotation[9];  // pipe to head
    float blur, focal;  // px, sigma; px a radian
} Beam;

// The LEDs', and what of either lamp each row collected.
typedef struct {
    float place[3], power[3];  // mm, pipe frame; as red, green and blue pixels see it
} Led;

typedef struct {
    Beam beam;
    Led led;
    const float *beam_gain, *led_gain;
    const float* rods;  // (n, 5) x, y, radius, back, front as seen from the beam's point, head's frame
    int64_t rod_count;
    int64_t slide;  // which of twin_lights.c lets the light through, and its numbers
    const float* slide_numbers;
    int64_t slide_size;
} Lights;

typedef struct {
    const uint8_t* albedo;  // (3, rows, pitch), 255 = all, with the first column once more after the last
    const float* base;      // (3,) of a bare wall, 1 = all
    int64_t rows, pitch;
} Paint;

// What the sensor makes of light, in grey levels.
typedef struct {
    float black, read, shot;  // level, noise, variance per level
    float balance[3];         // of red, green and blue
} Pixel;

// The sensor's noise: where in a table of standard normal numbers each row begins.
typedef struct {
    uint64_t state;
    const float* table;
    int64_t places;
} Dice;

void meet_cylinder(Stretch* s, const Eye* eye, const float* starts, int64_t plane, int64_t width, float radius);
void meet_wall(Stretch* s, const Eye* eye, bool apart, const Wall* wall, const float* light, bool ask_shadow);
void shine(Stretch* s, const Lights* lights);
void through_slits(Stretch* s, const Beam* beam, const float* numbers, int64_t size);
void through_fringes(Stretch* s, const Beam* beam, const float* numbers, int64_t size);
void reflected(const Stretch* s, const Paint* paint, const float* row, float* white);
void expose(uint8_t* row, const float* noise, const float* level, const Pixel* pixel, int64_t v, int64_t u, int64_t n);

// Pixels u0 .. u0 + n of row v, from ray_table of twin/rays.py: (3, H, W), plane = H W.
INLINE void begin(Stretch* const s, const float* const rays, const int64_t plane, const int64_t v, const int64_t width,
                  const int64_t u0, const int64_t n)
{
    s->n = n;
    s->full = (n + LANES - 1) & -LANES;
    s->v = v;
    s->u0 = u0;
    const float* const row = rays + v * width + u0;
    s->ray_x = row;
    s->ray_y = row + plane;
    memcpy(s->spread, row + 2 * plane, (size_t)n * sizeof(float));
}

INLINE Lights lights_of(const float* const beam_gain, const float* const beam, const float* const rods,
                        const int64_t slide, const float* const slide_numbers, const float* const led_gain,
                        const float* const led, const int64_t n, const int64_t s)
{
    Lights lights = {.beam_gain = beam_gain, .led_gain = led_gain, .rods = rods, .rod_count = n, .slide = slide};
    lights.slide_numbers = slide_numbers;
    lights.slide_size = s;
    memcpy(&lights.beam, beam, sizeof lights.beam);
    memcpy(&lights.led, led, sizeof lights.led);
    return lights;
}

// places : how many rows' noise may begin in the table.
INLINE Dice dice_of(const int64_t seed, const float* const table, const int64_t places)
{
    return (Dice){(uint64_t)seed * UINT64_C(0x9E3779B97F4A7C15) + 1, table, most(places, 1)};
}

INLINE const float* row_of(Dice* const dice, const int64_t v)
{
    dice->state = dice->state * UINT64_C(6364136223846793005) + (uint64_t)(2 * v + 1442695040888963407);
    return dice->table + (dice->state >> 33) % (uint64_t)dice->places;
}

// The mosaic's channel of pixel u0 + k: red at the first one, of rows and columns that are even.
INLINE int64_t channel_of(const Stretch* const s, const int64_t k)
{
    return (s->v & 1) + ((s->u0 + k) & 1);
}

// A value of three, for pixels at even and at odd places of a stretch.
INLINE float even_of(const Stretch* const s, const float* const three)
{
    return three[channel_of(s, 0)];
}

INLINE float odd_of(const Stretch* const s, const float* const three)
{
    return three[channel_of(s, 1)];
}

// Standard normal distribution function within 3e-4 (Abramowitz & Stegun 7.1.27).
INLINE float step_up(const float x)
{
    const float scaled = fabsf(x) * 0.70710678f;
    const float t = scaled < 6.0f ? scaled : 6.0f;  // p^8 must not overflow
    float p = 1.0f + t * (0.278393f + t * (0.230389f + t * (0.000972f + t * 0.078108f)));
    p = p * p;
    const float tail = 0.5f / (p * p);
    return x < 0.0f ? tail : 1.0f - tail;
}

// Deviation (mm) of the wall at a fractional place of its map, and its change per column and per row.
INLINE float between(const float* const cell, const int64_t pitch, const float fi, const float fj)
{
    const float left = cell[0] + fi * (cell[pitch] - cell[0]), right = cell[1] + fi * (cell[pitch + 1] - cell[1]);
    return left + fj * (right - left);
}

INLINE float wall_at(const Map* const map, const float column, const float row)
{
    const float r = held_f(row, 0.0f, (float)map->rows - 1.01f);
    const float c = held_f(column + 1.0f, 0.0f, (float)map->pitch - 1.01f);
    const int32_t i = (int32_t)r, j = (int32_t)c;
    return between(map->deviation + i * map->pitch + j, map->pitch, r - (float)i, c - (float)j);
}

#endif
