// Where the pipe is: the pose of a cylinder of known radius among points that may be dented, holed or wrong.
//
// Minimises (r - R), R known (Alzuhiri 2022, Eq. 4.8, free in rx, ry, tx, ty), with a mean and a twofold term of the
// radius beside it; wall/pose.py says why, and what it gives. Gauss-Newton on weighted points: a Cauchy loss comes
// near, then normal errors among wild points, both learnt on the way; patches of the wall that are off as a whole are
// left out. tests/reference/wall_pose.py is the same, to be read.
//
// A round goes through the points twice: each point's error and odds, and from what that makes of the patches the
// weights and their sums. What both need is kept: sines of the pose are taken once, roots and quotients once a point.

#include "wall_pose_patches.h"

// Held as a whole by test_pose.py and by the benchmark topics stabilisation (200 seeds, beside least squares told the
// clean points) and few_rings (one ring, damaged rings); not tried one by one.
#define CLOSE 2e-4        // radians or parts of the radius: the robust fit ends with a step this small ..
#define NEAR 2e-5         // .. and the likelihood with this
#define APPROACHES 30     // steps of the robust fit at most
#define THERE 0.01        // of the radius; points that scatter no more about it: the pose is near enough to begin with
#define ROUNDS 20         // steps of the likelihood at most
#define TILT_PRIOR 0.1    // radians; how far a head leans before a point has been seen, aligned with the pipe
#define SHAPE_PRIOR 0.02  // of the radius; how oval or how far from its nominal radius a pipe is
#define SHAPE_TOLERANCE 1e-3  // of the radius; what of that may still be there where the points do not show it
#define SHAPE_SHOWN 30.0  // chi-square of the shape's three numbers beyond which points do show it, one in a million
#define TILT_SHOWN 0.008  // radians; a lean known no better could be an oval, and the other way round: then ..
#define TILT_KEPT 1e-5    // radians; .. it is left at none, known no better than the play of a head's runners allows:
#define TILT_UNSEEN 0.04  // radians
#define LEAN_MOST 0.8     // radians; a pose beyond it is none ..
#define SHIFT_MOST 0.8    // of the radius; .. nor is one beyond this
#define SCALE_LEAST 1e-4  // of the radius; errors are taken for no smaller
#define NO_POINT 1e-4     // density of wild points, in points a sigma, that is always reckoned with
#define LEAST_POINTS 40   // points
#define LEAST_TURN 0.4    // part of the way round that must have points, or a circle is a guess
#define LEAST_LIKELY 1e-300  // a point less likely, some 37 sigma off, has no say in that
#define WORST_SIGMA 0.08     // of the radius; beyond it this is no pipe of that radius
#define LEAST_KEPT 0.4       // part of the points that must lie on the cylinder

static bool sane(const Fit* const fit)
{
    bool ok = true;
    for (int i = 0; i < FREE; i++) {
        ok &= fabs(fit->pose[i]) < (i < 2 ? LEAN_MOST : SHIFT_MOST * fit->radius);
    }
    return ok;
}

// Moves the pose near the answer, whatever part of the points is wrong; false where there is no step to take. Errors
// are those of the pose afterwards.
static bool approach(Fit* const fit, const double tilt)
{
    double prior[FREE];
    for (int round = 0; round < APPROACHES; round++) {
        look(fit);
        if (robust_below(fit, THERE * fit->radius)) {
            return true;
        }
        const double scale = larger(robust_sigma(fit, false), SCALE_LEAST * fit->radius);
        const double wide = 1.0 / (fit->cauchy * scale);
        const Place p = place_of(fit);
        Lanes sums[SUMS] = {0};
        double used[BLOCK];
        for (int64_t b = 0; b < fit->blocks; b++) {
            const Points* const points = fit->points + b;
            for (int n = 0; n < BLOCK; n++) {
                const double off = points->error[n] * wide;
                used[n] = points->root[n] * points->root[n] / (1.0 + off * off);
            }
            add_gradients(points, p, used, sums);
        }
        prior_of(fit, scale, tilt, SHAPE_PRIOR, prior);
        const double moved = step(fit, sums, prior);
        if (!(moved >= CLOSE)) {
            look(fit);
            return moved == moved;
        }
    }
    look(fit);
    return true;
}

typedef struct {
    double known, square;  // sums of the points' worth, and of the squares of their errors by it
    double sound, beyond;  // of trusted patches: points, and those 4..8 sigma off
} Tally;

// What each point is worth, the sums of that, and the sums of products of their gradients with it, (8, 8).
static Tally tally(const Fit* const fit, const double scale, Lanes* const sums)
{
    const Place place = place_of(fit);
    double used[BLOCK], worth[BLOCK], squares[BLOCK], trusted[BLOCK];
    Lanes known = {0}, square = {0};
    int64_t sound = 1, beyond = 0;
    for (int64_t b = 0; b < fit->blocks; b++) {
        const Points* const points = fit->points + b;
        for (int n = 0; n < BLOCK; n++) {
            trusted[n] = fit->trust[points->patch[n]];
        }
        for (int n = 0; n < BLOCK; n++) {
            const double off = points->error[n] * points->root[n], far = fabs(off);
            worth[n] = points->likely[n] * trusted[n];
            squares[n] = worth[n] * off * off;
            used[n] = worth[n] * (points->root[n] * points->root[n]);
            sound += trusted[n] > 0.5;
            beyond += (trusted[n] > 0.5) & (far > 4.0 * scale) & (far < 8.0 * scale);
        }
        for (int n = 0; n < BLOCK; n += LANES) {
            add(&known, worth + n);
            add(&square, squares + n);
        }
        add_gradients(points, place, used, sums);
    }
    return (Tally){added_up(&known), added_up(&square), (double)sound, (double)beyond};
}

// Whether the points show the shape: chi-square of its three numbers.
static bool shape_shown(const Fit* const fit)
{
    double of_shape[9], side[3], chi_square = 0.0;
    for (int i = 0; i < 3; i++) {
        side[i] = fit->pose[4 + i];
        for (int j = 0; j < 3; j++) {
            of_shape[3 * i + j] = fit->covariance[FREE * (4 + i) + 4 + j];
        }
    }
    if (!factored(of_shape, 3)) {
        return false;
    }
    solved(of_shape, 3, side);
    for (int i = 0; i < 3; i++) {
        chi_square += fit->pose[4 + i] * side[i];
    }
    return chi_square > SHAPE_SHOWN;
}

// The covariance, of what the points know and what was known beforehand; false where they do not say.
static bool covary(Fit* const fit, const double* const prior, const double sigma)
{
    double factor[FREE * FREE];
    for (int i = 0; i < FREE; i++) {
        fit->seen[FREE * i + i] += prior[i];
    }
    memcpy(factor, fit->seen, sizeof factor);
    if (!factored(factor, FREE)) {
        return false;
    }
    for (int i = 0; i < FREE; i++) {
        double* const row = fit->covariance + FREE * i;
        for (int j = 0; j < FREE; j++) {
            row[j] = i == j;
        }
        solved(factor, FREE, row);
        for (int j = 0; j < FREE; j++) {
            row[j] *= sigma * sigma;
        }
    }
    return true;
}

INLINE double lean_sigma(const Fit* const fit)
{
    return sqrt(larger(fit->covariance[0], fit->covariance[FREE + 1]));
}

// Moves the pose on to the most likely one, and finds its covariance; the errors' scale, infinite where there is none.
static double settle(Fit* const fit, const double tilt)
{
    double scale = larger(robust_sigma(fit, true), SCALE_LEAST * fit->radius);
    cut(fit, scale);
    double wild = NO_POINT / scale;  // wild points, per mm of radius and per point
    double shape = SHAPE_TOLERANCE;  // a hole as wide as an oval's flank is a hole as long as a circle will do
    bool mildly = true;
    double prior[FREE];
    for (int left = ROUNDS; left > 0; left--) {
        weigh(fit, scale, wild, left < ROUNDS);
        const double unrest = judge(fit, scale, mildly);
        Lanes sums[SUMS] = {0};
        const Tally found = tally(fit, scale, sums);
        if (!(found.known >= LEAST_KEPT * (double)fit->size)) {
            return HUGE_VAL;
        }
        scale = larger(sqrt(found.square / found.known), SCALE_LEAST * fit->radius);
        wild = larger(found.beyond / (8.0 * found.sound), NO_POINT) / scale;
        prior_of(fit, scale, tilt, shape, prior);
        const double moved = step(fit, sums, prior);
        if (moved != moved) {
            return HUGE_VAL;
        }
        if (mildly) {
            mildly = 2 * left > ROUNDS && moved > CLOSE;
            shape = mildly ? SHAPE_TOLERANCE : SHAPE_PRIOR;
            continue;
        }
        if (left > 3 && moved > NEAR) {
            continue;
        }
        if (!covary(fit, prior, scale * unrest)) {
            return HUGE_VAL;
        }
        if (shape == SHAPE_TOLERANCE || lean_sigma(fit) > TILT_SHOWN || shape_shown(fit)) {
            break;
        }
        shape = SHAPE_TOLERANCE;
    }
    return scale;
}

// Whether enough of 36 directions from the pipe's axis have points that count.
static bool all_round(const Fit* const fit)
{
    const int64_t some = 16;  // neighbours look one way: every sixteenth is soon enough
    bool seen[36] = {false};
    int directions = 0;
    for (int64_t first = 0; first < some; first++) {
        for (int64_t n = first; n < fit->size; n += some) {
            const Points* const points = fit->points + n / BLOCK;
            const int64_t i = n % BLOCK;
            if (points->likely[i] * fit->trust[points->patch[i]] > LEAST_LIKELY) {
                const double* const pose = fit->pose;
                const double turn = arc_tangent(points->y[i] - pose[3] + pose[0] * points->z[i],
                                                points->x[i] - pose[2] - pose[1] * points->z[i]);
                const int64_t way = around(whole(floor((turn * (1.0 / TURN) + 1.0) * 36.0), 0, 71) - 36, 36);
                directions += !seen[way];
                seen[way] = true;
                if (directions >= LEAST_TURN * 36.0) {
                    return true;
                }
            }
        }
    }
    return false;
}

// Moves the pose from the first guess to the most likely one; whether the points there make a pipe.
static bool likely_from(Fit* const fit, const double* const first, const double tilt)
{
    for (int i = 0; i < FREE; i++) {
        fit->pose[i] = i < 4 ? first[i] : 0.0;
    }
    if (!approach(fit, tilt) || !sane(fit)) {
        return false;
    }
    const double scale = settle(fit, tilt);
    return sane(fit) && scale <= WORST_SIGMA * fit->radius && all_round(fit);
}

// The head may lean all the same, with the shift that makes up for it: that much less is known.
static bool lean_unseen(Fit* const fit)
{
    double rest[25], along[2][FREE] = {{1.0, 0.0}, {0.0, 1.0}};
    for (int i = 0; i < 5; i++) {
        for (int j = 0; j < 5; j++) {
            rest[5 * i + j] = fit->seen[FREE * (2 + i) + 2 + j];
        }
    }
    if (!factored(rest, 5)) {
        return false;
    }
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < 5; i++) {
            along[k][2 + i] = -fit->seen[FREE * (2 + i) + k];
        }
        solved(rest, 5, along[k] + 2);
    }
    for (int i = 0; i < FREE; i++) {
        for (int j = 0; j < FREE; j++) {
            const double both = along[0][i] * along[0][j] + along[1][i] * along[1][j];
            fit->covariance[FREE * i + j] += TILT_UNSEEN * TILT_UNSEEN * both;
        }
    }
    return true;
}

static bool fitted_from(Fit* const fit, const double* const first, const bool one_ring)
{
    if (!one_ring) {
        if (!likely_from(fit, first, TILT_PRIOR)) {
            return false;
        }
        if (!(lean_sigma(fit) > TILT_SHOWN)) {
            return true;
        }
    }
    const double upright[4] = {0.0, 0.0, first[2], first[3]};
    return likely_from(fit, upright, TILT_KEPT) && lean_unseen(fit);
}

// Room to work in, in doubles, for that many points: blocks, sizes of errors, six of each patch.
#define BLOCKS(n) (((n) + BLOCK - 1) / BLOCK)
#define PATCHES_MOST(n) ((n) + 8)
#define ROOM(n) (BLOCKS(n) * (int64_t)(sizeof(Points) / sizeof(double) + BLOCK) + 6 * (PATCHES_MOST(n) + 1))

// Copies the points into their blocks, weights scaled to 1 on average.
static void laid_out(const Fit* const fit, const double* const x, const double* const y, const double* const z,
                     const double* const weight)
{
    Lanes sum = {0};
    for (int64_t b = 0; b < fit->blocks; b++) {
        Points* const points = fit->points + b;
        const int64_t first = b * BLOCK, count = filled(fit, b);
        const size_t bytes = (size_t)count * sizeof x[0];
        memcpy(points->x, x + first, bytes);
        memcpy(points->y, y + first, bytes);
        memcpy(points->z, z + first, bytes);
        memcpy(points->root, weight + first, bytes);
        for (int64_t n = count; n < BLOCK; n++) {
            points->x[n] = fit->radius;
            points->y[n] = points->z[n] = points->root[n] = 0.0;
        }
        for (int n = 0; n < BLOCK; n += LANES) {
            add(&sum, points->root + n);
        }
    }
    const double per_mean = (double)fit->size / added_up(&sum);
    for (int64_t b = 0; b < fit->blocks; b++) {
        double* const root = fit->points[b].root;
        for (int n = 0; n < BLOCK; n++) {
            root[n] = sqrt(root[n] * per_mean);
        }
    }
}

// Pose, robust sigma and covariance (4, 4) of the first `count` points, in `out`; false where they do not make a pipe.
// `seed` is tried first, then, where it is any other, a head that is aligned with the pipe.
DOOR bool pose_fit(const double* const points, const double* const weight, const int64_t count, const double radius,
                   const double* const seed, const bool one_ring, const double cauchy, const double sigma_of_mad,
                   double* const work, double* const out, const int64_t m, const int64_t w)
{
    const int64_t size = least(count, m), patches = PATCHES_MOST(size) + 1;
    if (size < LEAST_POINTS || w < ROOM(size)) {
        return false;
    }
    Fit fit = {.size = size, .blocks = BLOCKS(size), .cells_most = patches - 1};
    fit.radius = radius;
    fit.cauchy = cauchy;
    fit.sigma_of_mad = sigma_of_mad;
    fit.points = (Points*)work;
    fit.sizes = (double*)(fit.points + fit.blocks);
    fit.sums = fit.sizes + fit.blocks * BLOCK;
    fit.every = fit.sums + 2 * patches;
    fit.trust = fit.every + patches;
    fit.far = fit.trust + patches;
    fit.fars = fit.far + patches;
    laid_out(&fit, points, points + m, points + 2 * m, weight);
    const double aligned[4] = {0.0, 0.0, 0.0, 0.0};
    const bool another = seed[0] != 0.0 || seed[1] != 0.0 || seed[2] != 0.0 || seed[3] != 0.0;
    if (!fitted_from(&fit, seed, one_ring) && !(another && fitted_from(&fit, aligned, one_ring))) {
        return false;
    }
    look(&fit);
    memcpy(out, fit.pose, 4 * sizeof out[0]);
    out[4] = robust_sigma(&fit, false);
    for (int i = 0; i < 4; i++) {
        memcpy(out + 5 + 4 * i, fit.covariance + FREE * i, 4 * sizeof out[0]);
    }
    return true;
}
