// What a frame's doors call of one another: Python is called back once for all steps from a picture to its lines, and
// once for those from lines to slits.
#ifndef ANNULUS_RINGS_FRAME_H
#define ANNULUS_RINGS_FRAME_H

#include "native.h"
#include "rings_picture.h"

// What a coarse look at a frame says.
typedef struct {
    int32_t *black, *gain;  // (3,): levels of black, and gains in 1/64
    int64_t* range;         // (2,): samples from where to where there is light
} look_t;

// The polar lines of a grid: see annulus_pipe.rings.polar.
typedef struct {
    const uint32_t* address;  // (lines + 2, length)
    const uint16_t* part;     // (lines + 2, length)
    const int64_t* stop;      // (lines,)
    int64_t lines, length;
} lines_t;

void rings_look(const picture_t* picture, bool mosaic, const lines_t* lines, int64_t every, int64_t px,
                const double* limits, uint8_t* seen, int64_t room, const look_t* look);
void rings_strongest(const picture_t* picture, bool mosaic, double cx, double cy, double inner, double outer,
                     const look_t* look, uint8_t* plane, int64_t room);
void rings_light(const picture_t* picture, bool mosaic, const double* ways, int64_t lines, int64_t first,
                 const int64_t* direction, const int32_t* samples, int64_t size, double* light, double* bright,
                 int64_t n);
void rings_list(const uint8_t* colour, int64_t size, const uint8_t* pattern, int32_t* slit, int32_t* name, uint8_t* fit,
                int64_t* counts, int64_t c, int64_t p, int64_t n);
void rings_deviations(const double* points, int64_t listed, const double* rotation, const double* shift, double radius,
                      double* deviation, int64_t n);

#endif
