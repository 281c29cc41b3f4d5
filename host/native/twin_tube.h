// A pipe of pieces, as twin/course.py lays it: where a place lies in it, and where a ray leaves it. Float64: chainage
// is metres, relief a hundredth of a millimetre.
#ifndef ANNULUS_TWIN_TUBE_H
#define ANNULUS_TWIN_TUBE_H

#include "mathematics.h"
#include "twin.h"

typedef struct {
    double x, y, z;
} Point;

// One row of the table of pieces.
typedef struct {
    double start, length;            // chainage, mm
    Point origin, across, down, on;  // space; the axes of the piece where it begins: two across it, one along
    double bend;                     // radius of its axis, mm, or 0; towards (dx, dy) across it
    double dx, dy;
    double radius, slope;  // mm; mm a mm
    double bright;         // of its wall, 1 = as it is painted
} Piece;

typedef struct {
    double level;      // of water, as y in space; far below where there is none
    double first;      // chainage of the first row of the table of what is free
    double a_mm;       // its rows a mm
    double turn_rate;  // sine of how far the axes of straight pieces stand to each other within a leap
    double near_mm, leap_mm;
    double map_rows_a_mm, map_columns;  // of the wall's map; once round
} TubeNumbers;

typedef struct {
    TubeNumbers numbers;
    Map map;
    const Piece* pieces;
    int64_t piece_count;
    const double* beads;  // (n, 4) chainage, height, width, notch
    int64_t bead_count;
    const double* bores;  // (n, 8) a point of the pipe's axis, outwards, radius, depth
    int64_t bore_count;
    const uint8_t* rough;  // by chainage: 1 where the map has anything
    const double* near;    // .. nothing within near_mm is nearer to the axis
    const double* leap;    // .. nor than this within leap_mm
    int64_t rows;
} Tube;

// Where a place lies: piece, chainage, two coordinates across, and how far out of the pipe (mm; below 0 inside).
typedef struct {
    int64_t piece;
    double s, u, v, out;
} Spot;

Spot spot_at(const Tube* tube, Point place, int64_t hint);
double leaves(const Tube* tube, Point start, Point way, double far, int64_t* piece);
Point normal_at(const Tube* tube, Point place, int64_t hint);
double map_column(const Tube* tube, double u, double v);

// Of the tables that twin/course.py makes; see the declaration there.
INLINE Tube tube_of(const double* const course, const double* const pieces, const double* const beads,
                    const double* const bores, const float* const deviation, const uint8_t* const rough,
                    const double* const near, const double* const leap, const int64_t q, const int64_t b,
                    const int64_t o, const int64_t r, const int64_t p, const int64_t y)
{
    Tube tube = {.map = {deviation, r, p}, .pieces = (const Piece*)pieces, .piece_count = q};
    memcpy(&tube.numbers, course, sizeof tube.numbers);
    tube.beads = beads;
    tube.bead_count = b;
    tube.bores = bores;
    tube.bore_count = o;
    tube.rough = rough;
    tube.near = near;
    tube.leap = leap;
    tube.rows = y;
    return tube;
}

INLINE Point beyond(const Point from, const Point way, const double range)
{
    return (Point){from.x + range * way.x, from.y + range * way.y, from.z + range * way.z};
}

INLINE double times(const Point a, const Point b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINE Point from_to(const Point a, const Point b)
{
    return (Point){b.x - a.x, b.y - a.y, b.z - a.z};
}

INLINE double root(const double square)
{
    return sqrt(square > 0.0 ? square : 0.0);
}

#endif
