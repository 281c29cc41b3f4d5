// Makes recorded calls of doors again and compares what they write, byte for
// byte; a NaN is a NaN, whatever its sign. recorded.py writes the table of
// doors into this file, and the file of calls that is read: numbers of 8 bytes,
// blocks of memory filled up to 8. Each block is allocated by itself, so that a
// sanitizer sees what is read beyond it.
#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SLOTS 64  // arguments and sizes of a call
#define BLOCKS 64 // that it is given
#define NONE (-2) // an array that was left out; -1: one of no size

typedef union {
  void *p;
  double f8;
  float f4;
  int64_t i8;
  int32_t i4;
  int16_t i2;
  uint64_t u8;
  uint32_t u4;
  uint16_t u2;
  uint8_t u1;
  bool b1;
} slot;

typedef struct {
  const char *name;
  char kind;
  int bytes;
  bool is_array, written;
  int dimensions;
  int sizes[6]; // a letter's number, or less than nought: that many
} argument;

typedef struct {
  const char *name;
  slot (*run)(const slot *);
  const argument *arguments;
  int count, letters;
  char returns;
  int bytes;
} door;

// DOORS

static bool alike(const char kind, const int bytes,
                  const unsigned char *const a, const unsigned char *const b) {
  if (memcmp(a, b, (size_t)bytes) == 0) {
    return true;
  }
  if (kind != 'f') {
    return false;
  }
  slot x = {0}, y = {0};
  memcpy(&x, a, (size_t)bytes);
  memcpy(&y, b, (size_t)bytes);
  return bytes == 8 ? x.f8 != x.f8 && y.f8 != y.f8
                    : x.f4 != x.f4 && y.f4 != y.f4;
}

static double shown(const char kind, const int bytes,
                    const unsigned char *const at) {
  slot x = {0};
  memcpy(&x, at, (size_t)bytes);
  return kind == 'f' ? (bytes == 8 ? x.f8 : (double)x.f4) : (double)x.i8;
}

int main(int argc, char **argv) {
  FILE *const file = argc == 2 ? fopen(argv[1], "rb") : NULL;
  if (file == NULL) {
    return 2;
  }
  fseek(file, 0, SEEK_END);
  const size_t length = (size_t)ftell(file);
  unsigned char *const all = malloc(length);
  rewind(file);
  if (all == NULL || fread(all, 1, length, file) != length) {
    return 2;
  }
  const int64_t *at = (const int64_t *)(const void *)all;
  const int64_t blobs = *at++;
  const int64_t **const blob = malloc((size_t)blobs * sizeof *blob + 8);
  for (int64_t i = 0; i < blobs; i++) {
    blob[i] = at;
    at += 1 + (*at + 7) / 8;
  }
  int status = 0;
  for (int64_t left = *at++; left > 0; left--) {
    const door *const one = &DOORS[*at++];
    const int64_t blocks = *at++;
    unsigned char *memory[BLOCKS];
    const unsigned char *after[BLOCKS];
    for (int64_t i = 0; i < blocks; i++, at += 2) {
      const size_t bytes = (size_t)*blob[at[0]];
      memory[i] = malloc(bytes);
      memcpy(memory[i], blob[at[0]] + 1, bytes);
      after[i] = (const unsigned char *)(blob[at[1]] + 1);
    }
    slot a[SLOTS];
    const unsigned char *expected[SLOTS] = {NULL};
    for (int k = 0; k < one->count; k++) {
      if (!one->arguments[k].is_array) {
        a[k].i8 = *at++;
        continue;
      }
      a[k].p = at[0] == NONE ? NULL
               : at[0] < 0   ? (void *)&status
                             : (void *)(memory[at[0]] + at[1]);
      expected[k] = at[0] < 0 ? NULL : after[at[0]] + at[1];
      at += 2;
    }
    const slot *const sizes = a + one->count;
    for (int k = 0; k < one->letters; k++) {
      a[one->count + k].i8 = *at++;
    }
    const slot result = one->run(a);
    if (!alike(one->returns, one->bytes, (const unsigned char *)&result,
               (const unsigned char *)at)) {
      printf("%s: gives %" PRId64 ", expected %" PRId64 "\n", one->name,
             result.i8, *at);
      status = 1;
    }
    at++;
    for (int k = 0; k < one->count; k++) {
      const argument *const of = &one->arguments[k];
      int64_t items = of->is_array && of->written && expected[k] != NULL;
      for (int d = 0; d < of->dimensions; d++) {
        items *= of->sizes[d] < 0 ? -of->sizes[d] : sizes[of->sizes[d]].i8;
      }
      const unsigned char *const written = a[k].p;
      for (int64_t i = 0; i < items; i++) {
        const unsigned char *const x = written + i * of->bytes,
                                   *const y = expected[k] + i * of->bytes;
        if (!alike(of->kind, of->bytes, x, y)) {
          printf("%s: %s[%" PRId64 "] is %.17g, expected %.17g\n", one->name,
                 of->name, i, shown(of->kind, of->bytes, x),
                 shown(of->kind, of->bytes, y));
          status = 1;
          break;
        }
      }
    }
    for (int64_t i = 0; i < blocks; i++) {
      free(memory[i]);
    }
  }
  free(blob);
  free(all);
  fclose(file);
  return status;
}
