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
    float lens[5];    // k1 k2 p1 p2 k3 of OpenCV
    float mirror[4];  // centre and radius of a ball in the slide's frame, mm; radius 0: none
} FringeNumbers;

// Where light leaves the slide for a place that it comes to over a ball: the direction, in place of the place. Of the
// angles at which a ray may meet the ball the one that passes through the place, by halving and then by secants: not as
// the measurement finds it.
static void over_ball(const FringeNumbers* const slide, float* const px, float* const py, float* const pz)
{
    const double mx = (double)slide->mirror[0], my = (double)slide->mirror[1], mz = (double)slide->mirror[2];
    const double r = (double)slide->mirror[3], d = sqrt(mx * mx + my * my + mz * mz);
    const double ux = mx / d, uy = my / d, uz = mz / d, x = (double)*px, y = (double)*py, z = (double)*pz;
    const double s = x * ux + y * uy + z * uz, ax = x - s * ux, ay = y - s * uy, az = z - s * uz;
    const double t = sqrt(ax * ax + ay * ay + az * az), over = t > 0.0 ? 1.0 / t : 0.0;
    double low = 0.0, high = arc_tangent(sqrt(d * d - r * r), r), miss_low = t, miss_high = -1.0, ms = d - r, mt = 0.0;
    for (int turn = 0; turn < 16; turn++) {
        const double share = turn < 5 || !(miss_low > miss_high) ? 0.5 : miss_low / (miss_low - miss_high);
        const double middle = low + (high - low) * (share < 0.02 ? 0.02 : share > 0.98 ? 0.98 : share);
        double c, e;
        cosine_sine(middle, &c, &e);
        ms = d - r * c;
        mt = r * e;
        const double size = sqrt(ms * ms + mt * mt), twice = 2.0 * (mt * e - ms * c) / size;
        const double bs = ms / size + twice * c,
                     bt = mt / size - twice * e;  // goes on along: less twice its normal part
        const double miss = (t - mt) * -bs + (s - ms) * bt;
        if (miss > 0.0) {
            low = middle;
            miss_low = miss;
        } else {
            high = middle;
            miss_high = miss;
        }
    }
    *px = (float)(ms * ux + mt * ax * over);
    *py = (float)(ms * uy + mt * ay * over);
    *pz = (float)(ms * uz + mt * az * over);
}

// Phase (rad), and 1 where there is light.
INLINE void phases(const Stretch* const s, const Beam* const beam, const FringeNumbers* const slide,
                   const int64_t first, const bool rings, float* const phase, float* const open)
{
    const float* const r = slide->rotation;
    const float r00 = r[0], r01 = r[1], r02 = r[2], r10 = r[3], r11 = r[4], r12 = r[5], r20 = r[6], r21 = r[7];
    const float r22 = r[8], vx = beam->centre[0], vy = beam->centre[1], vz = beam->centre[2];
    const float near = slide->field[0], far = slide->field[1], *const m = slide->mirror, *const k = slide->lens;
    const bool ball = m[3] > 0.0f,
               bent = (k[0] != 0.0f) | (k[1] != 0.0f) | (k[2] != 0.0f) | (k[3] != 0.0f) | (k[4] != 0.0f);
    // the beam's centre is the ball's image of the slide: as far along the way to its middle, of that
    const float away = ball ? sqrtf(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) : 1.0f;
    const float image = ball ? (away - m[3]) * (1.0f + m[3] / (2.0f * away - m[3])) / away : 0.0f;
    for (int64_t l = 0; l < LANES; l++) {
        const float px = s->x[first + l] - vx, py = s->y[first + l] - vy, pz = s->z[first + l] - vz;
        float x = r00 * px + r01 * py + r02 * pz, y = r10 * px + r11 * py + r12 * pz;
        float z = r20 * px + r21 * py + r22 * pz;
        if (ball) {
            x += image * slide->mirror[0];
            y += image * slide->mirror[1];
            z += image * slide->mirror[2];
            over_ball(slide, &x, &y, &z);
        }
        bool lit;
        float turn;
        if (rings) {
            const float rho = sqrtf(x * x + y * y);
            lit = (z > 0.0f) & (near * z < rho) & (rho < far * z);
        } else {
            lit = (z > 0.0f) & (fabsf(x) < near * z) & (fabsf(y) < far * z);
        }
        if (bent) {  // the field is of directions; what of the slide is seen there is farther out or in
            const float p = x / z, q = y / z, r2 = p * p + q * q;
            const float radial = 1.0f + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
            x = p * radial + 2.0f * k[2] * p * q + k[3] * (r2 + 2.0f * p * p);
            y = q * radial + k[2] * (r2 + 2.0f * q * q) + 2.0f * k[3] * p * q;
            z = 1.0f;
        }
        if (rings) {
            const float rho = sqrtf(x * x + y * y);
            turn = slide->a * z / (rho > 1e-6f ? rho : 1e-6f);
        } else {
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
