// The golden vectors of protocol/vectors.json as a C table; vectors.c is generated.

#ifndef ANNULUS_VECTORS_H
#define ANNULUS_VECTORS_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    const char* name;
    uint8_t id;
    uint16_t sequence;
    uint8_t boot;
    uint8_t body_length;
    uint8_t wire_length;
    const uint8_t* body;
    const uint8_t* wire;
    int (*reproduce)(uint8_t* payload);  // packs the fields; 1 when unpacking gives them back. NULL: no payload
} vector_t;

typedef struct {
    const char* name;
    uint8_t wire_length;
    const uint8_t* wire;
} bad_vector_t;

extern const vector_t vectors[];
extern const size_t vector_count;
extern const bad_vector_t bad_vectors[];
extern const size_t bad_vector_count;

#endif
