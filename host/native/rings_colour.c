// Which of the pattern's colours a stripe is: annulus_pipe.rings.decode.classify has the theory.

#include <math.h>
#include <string.h>

#include "native.h"
#include "rings_frame.h"
#include "selection.h"

#define UNKNOWN 255  // as rings.decode: matches any colour, proves nothing
#define COLOURS 3
#define ROUNDS 2  // of references moved to what their stripes look like: no stripe changes sides after that

static int64_t least_members(const double part, const int64_t size)
{
    const double some = part * (double)size;
    return some > 8.0 ? (int64_t)ceil(some) : 8;
}

// Moves gains (3,) of red, green, blue and references (u, 3) to this frame's own stripes. light (r, c): blue, green,
// red of the first `size` stripes in three rows, and in the next three of as many more; every so manieth is asked.
// bright: the part of stripes below a frame's bright level; share: of them that a colour is learnt from. work (5, w):
// room to work in.
static void learn(const double* const light, const int64_t size, const int64_t every, const int64_t* const used,
                  const double bright, const double share, double* const work, double* const gain,
                  double* const reference, const int64_t r, const int64_t c, const int64_t u, const int64_t w)
{
    const int64_t there_are = least(size, c);
    const int64_t some = least((there_are * (r / 3) + every - 1) / every, w);
    double* const red = work;
    double* const green = work + w;
    double* const blue = work + 2 * w;
    double* const name = work + 3 * w;
    double* const values = work + 4 * w;
    const double* rows = light;
    for (int64_t n = 0, at = 0; n < some; n++, at += every) {
        for (; at >= there_are; at -= there_are) {
            rows += 3 * c;  // of the next stripe of each slit
        }
        blue[n] = rows[at];
        green[n] = rows[c + at];
        red[n] = rows[2 * c + at];
    }
    for (int64_t i = 0; i < u; i++) {
        const int64_t channel = bounded(used[i], 0, COLOURS - 1);
        memcpy(values, work + channel * w, (size_t)some * sizeof *values);
        const double level = ranked(values, some, (int64_t)(bright * (double)some));
        gain[channel] = 1.0 / (level > 1e-6 ? level : 1e-6);
    }
    int64_t there = 0;
    for (int64_t n = 0; n < some; n++) {
        const double x = red[n] * gain[0], y = green[n] * gain[1], z = blue[n] * gain[2];
        const double length = sqrt((x * x + y * y) + z * z);
        if (length > 1e-6) {
            red[there] = x / length;
            green[there] = y / length;
            blue[there] = z / length;
            there++;
        }
    }
    const int64_t enough = least_members(share, there);
    for (int round = 0; round < ROUNDS; round++) {
        for (int64_t n = 0; n < there; n++) {
            double best = -1.0, which = 0.0;
            for (int64_t i = 0; i < u; i++) {
                const double* const ours = reference + 3 * i;
                const double likeness = (red[n] * ours[0] + green[n] * ours[1]) + blue[n] * ours[2];
                which = likeness > best ? (double)i : which;
                best = likeness > best ? likeness : best;
            }
            name[n] = which;
        }
        for (int64_t i = 0; i < u; i++) {
            double median[COLOURS], square = 0.0;
            int64_t members = 0;
            for (int channel = 0; channel < COLOURS; channel++) {
                const double* const of_channel = work + channel * w;
                members = 0;
                for (int64_t n = 0; n < there; n++) {
                    values[members] = of_channel[n];
                    members += name[n] == (double)i;
                }
                if (members < enough) {
                    break;
                }
                median[channel] = middle(values, members);
                square += median[channel] * median[channel];
            }
            if (members >= enough && square > 0.0) {
                for (int channel = 0; channel < COLOURS; channel++) {
                    reference[3 * i + channel] = median[channel] / sqrt(square);
                }
            }
        }
    }
}

// Colours of stripes, indices into "RGB" or UNKNOWN: out (s, c), of a table of light as above.
static void classify(const double* const light, const int64_t size, const double* const gain,
                     const double* const reference, const int64_t* const used, const double likeness,
                     uint8_t* const out, const int64_t r, const int64_t c, const int64_t u, const int64_t s)
{
    double ours[COLOURS][COLOURS] = {{0.0}}, names[COLOURS] = {0.0}, never[COLOURS];
    const int64_t colours = least(u, COLOURS);
    for (int64_t i = 0; i < COLOURS; i++) {
        never[i] = i < colours ? 0.0 : -1e300;  // a colour that the pattern has not is like no stripe
        for (int channel = 0; channel < COLOURS && i < colours; channel++) {
            ours[i][channel] = reference[3 * i + channel];
        }
        names[i] = i < colours ? (double)bounded(used[i], 0, COLOURS - 1) : 0.0;
    }
    const double alone = colours == 1 ? 1.0 : 0.0;
    for (int64_t part = 0; part < least(s, r / 3); part++) {
        const double* const blue = light + 3 * part * c;
        const double* const green = blue + c;
        const double* const red = green + c;
        uint8_t* const restrict named = out + part * c;
        for (int64_t n = 0; n < least(size, c); n++) {
            const double x = red[n] * gain[0], y = green[n] * gain[1], z = blue[n] * gain[2];
            const double length = sqrt((x * x + y * y) + z * z);
            double first = -1.0, second = -1.0, name = 0.0;
            for (int i = 0; i < COLOURS; i++) {
                const double like = ((ours[i][0] * x + ours[i][1] * y) + ours[i][2] * z) + never[i];
                const double lesser = like < first ? like : first;
                second = lesser > second ? lesser : second;
                name = like > first ? names[i] : name;
                first = like > first ? like : first;
            }
            // whether something holds is 1.0 or 0.0, so that it is worked out side by side
            const double apart = first - second > likeness * length ? 1.0 : alone;
            const double clear = length > 1e-6 ? apart : 0.0;
            named[n] = (uint8_t)(int32_t)(clear > 0.0 ? name : (double)UNKNOWN);
        }
    }
}

// The colours of a frame's stripes, and which rings each slit may be by them. gain, reference: as they are known, or
// from `start` (u, 3) on moved to every so manieth stripe of this frame; every 0: they are known. likeness: a colour
// must be nearer its reference than any other by this much of the cosine. pattern: of the rings that slits are listed
// for, see `rings_list`; or none.
DOOR void rings_name(const double* const light, const int64_t size, const int64_t every, const int64_t* const used,
                     const double* const start, const double bright, const double share, const double likeness,
                     double* const work, double* const gain, double* const reference, uint8_t* const out,
                     const uint8_t* const pattern, int32_t* const slit, int32_t* const name, uint8_t* const fit,
                     int64_t* const counts, const int64_t r, const int64_t c, const int64_t u, const int64_t w,
                     const int64_t s, const int64_t p, const int64_t n)
{
    if (every > 0) {
        memset(gain, 0, COLOURS * sizeof *gain);
        memcpy(reference, start, (size_t)(COLOURS * u) * sizeof *start);
        learn(light, size, every, used, bright, share, work, gain, reference, r, c, u, w);
    }
    classify(light, size, gain, reference, used, likeness, out, r, c, u, s);
    if (pattern != NULL && s == 2) {
        rings_list(out, size, pattern, slit, name, fit, counts, c, p, n);
    }
}
