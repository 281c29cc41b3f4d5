// What a slide of a sinusoid lets through: stripes across one way, or rings whose phase is linear along a pipe.
//
// Lens blur is not a filter over the image: it lowers the modulation where the phase changes fast from pixel to pixel,
// and each harmonic by its own square.

#include "mathematics.h"
#include "twin.h"

// Before the harmonics: (n, 2) of their cosine and sine, from the second order on.
typedef struct {
    float rotation[9];  // pipe to slide
    float field[2];     // tangents: of rings where they begin and end, of stripes half the field's sides
    float modulation;
    float colour[3];  // as red, green and blue pixels see it
    float rings;      // above 0; else stripes
    float a, b;       // rad a unit: of stripes along both sides of the field, of rings along the pipe
    float phase0;     // rad
} FringeNumbers;

// Phase (rad), and 1 where there is light.
INLINE void phases(const Stretch* const s, const Beam* const beam, const FringeNumbers* const slide,
                   const int64_t first, const bool rings, float* const phase, float* const open)
{
    const float* const r = slide->rotation;
    const float r00 = r[0], r01 = r[1], r02 = r[2], r10 = r[3], r11 = r[4], r12 = r[5], r20 = r[6], r21 = r[7];
    const float r22 = r[8], vx = beam->centre[0], vy = beam->centre[1], vz = beam->centre[2];
    const float near = slide->field[0], far = slide->field[1];
    for (int64_t l = 0; l < LANES; l++) {
        const float px = s->x[first + l] - vx, py = s->y[first + l] - vy, pz = s->z[first + l] - vz;
        const float x = r00 * px + r01 * py + r02 * pz, y = r10 * px + r11 * py + r12 * pz;
        const float z = r20 * px + r21 * py + r22 * pz;
        bool lit;
        float turn;
        if (rings) {
            const float rho = sqrtf(x * x + y * y);
            lit = (z > 0.0f) & (near * z < rho) & (rho < far * z);
            turn = slide->a * z / (rho > 1e-6f ? rho : 1e-6f);
        } else {
            lit = (z > 0.0f) & (fabsf(x) < near * z) & (fabsf(y) < far * z);
            turn = (slide->a * x + slide->b * y) / z;
        }
        open[l] = lit ? 1.0f : 0.0f;
        phase[l] = lit ? turn + slide->phase0 : 0.0f;
    }
}

// Adds one wave of so many periods to the phase's one; it is blurred by the square of its order.
INLINE void wave(const float* const phase, const float* const rate, const float order, const float cosines,
                 const float sines, float* const light)
{
    for (int64_t l = 0; l < LANES; l++) {
        const float turn = order * phase[l];
        const double blurred = exponential((double)(-0.5f * order * order * rate[l] * rate[l]));
        double c, s;
        cosine_sine((double)turn, &c, &s);
        light[l] += (float)(blurred * ((double)cosines * c + (double)sines * s));
    }
}

void through_fringes(Stretch* const s, const Beam* const beam, const float* const numbers, const int64_t size)
{
    FringeNumbers slide;
    const int64_t before = (int64_t)(sizeof slide / sizeof(float));
    if (size < before) {
        return;
    }
    memcpy(&slide, numbers, sizeof slide);
    const int64_t harmonics = (size - before) / 2;
    const float even = even_of(s, slide.colour), odd = odd_of(s, slide.colour), modulation = slide.modulation;
    for (int64_t first = 0; first < s->n; first += LANES) {
        float phase[LANES], open[LANES], rate[LANES], light[LANES];
        if (slide.rings > 0.0f) {
            phases(s, beam, &slide, first, true, phase, open);
        } else {
            phases(s, beam, &slide, first, false, phase, open);
        }
        for (int64_t l = 0; l < LANES; l++) {
            rate[l] = beam->blur * s->spread[first + l];
            light[l] = 1.0f;
        }
        wave(phase, rate, 1.0f, modulation, 0.0f, light);
        for (int64_t k = 0; k < harmonics; k++) {
            const float* const both = numbers + before + 2 * k;
            wave(phase, rate, (float)(k + 2), modulation * both[0], modulation * both[1], light);
        }
        for (int64_t l = 0; l < LANES; l++) {
            const float colour = ((first + l) & 1) != 0 ? odd : even;
            const float share = colour * open[l] * (light[l] > 0.0f ? light[l] : 0.0f) / (1.0f + modulation);
            s->level[first + l] = s->lit[first + l] * share;
        }
    }
}
