// Where the axis of a pipe begins to do something else: which points of a frame are looked at, and what a piece that
// begins at each of some places would explain of what is left.
//
// A piece that begins at a place p changes what a point ahead of it, d = z - p, is off its wall by, to first order, by
//     -(u, v) offset - (u, v) d turn - (u, v) d^2/2 curvature - radius step - d taper                              (1)
// with (u, v) its direction across the pipe. Heads follow: each frame's five numbers are eliminated from the normal
// equations of those eight, N - sum B H^-1 B^T, where H are a head's own and B what it shares with the eight (Schur).

#include "lanes.h"
#include "mathematics.h"
#include "selection.h"
#include "solving.h"

enum { HEAD = 5, BEGINS = 8, ROWS = 2 * BEGINS + HEAD + 1 };  // of the room: of Eq. 1, and weighed; heads; what is left
enum { PAIRS = BEGINS / 2 + (HEAD + 1) / 2 };
static const double SECTOR_OF_RAD = 0.15915494309189535;  // turns a radian

// Normal equations (f, 5, 5) of the heads, factored, and their right sides (f, 5).
static void heads_of(const int64_t* const first, const double* const weight, const double* const residual,
                     const double* const lean, const double* const held_by, double* const heads, double* const pull,
                     const int64_t n, const int64_t f)
{
    for (int64_t frame = 0; frame < f; frame++) {
        double *const matrix = heads + HEAD * HEAD * frame, *const side = pull + HEAD * frame;
        memset(matrix, 0, HEAD * HEAD * sizeof *matrix);
        memset(side, 0, HEAD * sizeof *side);
        const int64_t begin = bounded(first[frame], 0, n), end = frame + 1 < f ? bounded(first[frame + 1], 0, n) : n;
        for (int64_t i = begin; i < end; i++) {
            for (int a = 0; a < HEAD; a++) {
                const double by = weight[i] * lean[HEAD * i + a];
                side[a] += by * residual[i];
                for (int b = 0; b <= a; b++) {
                    matrix[HEAD * a + b] += by * lean[HEAD * i + b];
                }
            }
        }
        for (int a = 0; a < HEAD; a++) {
            matrix[(HEAD + 1) * a] += held_by[a];
        }
        if (!factored(matrix, HEAD)) {
            memset(matrix, 0, HEAD * HEAD * sizeof *matrix);  // nothing follows a head that nobody saw
        }
    }
}

// Rows of the room of a frame's points ahead of a place; how many, filled up with zeros to whole lanes.
static int lay(const int64_t begin, const int64_t end, const double at, const double* const z,
               const double* const direction, const double* const weight, const double* const residual,
               const double* const lean, double* const room, const int64_t m)
{
    int64_t size = 0;
    for (int64_t i = begin; i < end && size < m - LANES; i++) {
        if (!(z[i] > at) || weight[i] == 0.0) {
            continue;
        }
        const double d = z[i] - at, half = 0.5 * d * d, w = weight[i], u = direction[2 * i], v = direction[2 * i + 1];
        const double change[BEGINS] = {-u, -v, -u * d, -v * d, -u * half, -v * half, -1.0, -d};  // Eq. 1
        for (int64_t k = 0; k < BEGINS; k++) {
            room[k * m + size] = change[k];
            room[(BEGINS + k) * m + size] = w * change[k];
        }
        for (int64_t k = 0; k < HEAD; k++) {
            room[(2 * BEGINS + k) * m + size] = w * lean[HEAD * i + k];
        }
        room[(2 * BEGINS + HEAD) * m + size] = w * residual[i];
        size++;
    }
    const int64_t filled = (size + LANES - 1) / LANES * LANES;
    for (int64_t k = 0; k < ROWS; k++) {
        for (int64_t i = size; i < filled; i++) {
            room[k * m + i] = 0.0;
        }
    }
    return (int)filled;
}

// Normal equations (g, 8, 8) and right sides (g, 8) of what begins at each of places (g,), heads eliminated. first
// (f,): each frame's first sighting; low, high (f,): where they lie; z, direction, weight, residual, lean (n, ..).
// held_by: added to a head's diagonal. heads, pull, room (22, m): room to work in; m more by eight than the most of a
// frame.
DOOR void begin_normals(const int64_t* const first, const double* const low, const double* const high,
                        const double* const z, const double* const direction, const double* const weight,
                        const double* const residual, const double* const lean, const double* const held_by,
                        const double* const places, double* const heads, double* const pull, double* const room,
                        double* const normals, double* const rights, const int64_t f, const int64_t n, const int64_t g,
                        const int64_t m)
{
    heads_of(first, weight, residual, lean, held_by, heads, pull, n, f);
    for (int64_t place = 0; place < g; place++) {
        double *const normal = normals + BEGINS * BEGINS * place, *const right = rights + BEGINS * place;
        memset(normal, 0, BEGINS * BEGINS * sizeof *normal);
        memset(right, 0, BEGINS * sizeof *right);
        int64_t from = f, upto = 0;
        for (int64_t frame = 0; frame < f; frame++) {
            if (high[frame] > places[place] && low[frame] < places[place]) {
                from = least(from, frame);
                upto = frame + 1;
            }
        }
        for (int64_t frame = from; frame < upto; frame++) {
            const int64_t begin = bounded(first[frame], 0, n),
                          end = frame + 1 < f ? bounded(first[frame + 1], 0, n) : n;
            const int size = lay(begin, end, places[place], z, direction, weight, residual, lean, room, m);
            if (!size) {
                continue;
            }
            double all[BEGINS][2 * PAIRS];  // of Eq. 1 with Eq. 1, with the head's numbers, with what is left
            for (int group = 0; group < 2; group++) {
                for (int pair = 0; pair < PAIRS; pair++) {
                    Lanes sums[8];
                    memset(sums, 0, sizeof sums);
                    add_products(sums, room + 4 * group * m, room + (BEGINS + 2 * pair) * m, (int)m, size);
                    for (int k = 0; k < 4; k++) {
                        all[4 * group + k][2 * pair] = added_up(sums + 2 * k);
                        all[4 * group + k][2 * pair + 1] = added_up(sums + 2 * k + 1);
                    }
                }
            }
            const double *const factor = heads + HEAD * HEAD * frame, *const side = pull + HEAD * frame;
            double follow[BEGINS + 1][HEAD];
            for (int k = 0; k < BEGINS; k++) {
                memcpy(follow[k], all[k] + BEGINS, sizeof follow[k]);
                solved(factor, HEAD, follow[k]);
            }
            memcpy(follow[BEGINS], side, sizeof follow[BEGINS]);
            solved(factor, HEAD, follow[BEGINS]);
            for (int a = 0; a < BEGINS; a++) {
                const double* const both = all[a] + BEGINS;
                for (int b = 0; b <= BEGINS; b++) {
                    double taken = 0.0;
                    for (int k = 0; k < HEAD; k++) {
                        taken += both[k] * follow[b][k];
                    }
                    if (b < BEGINS) {
                        normal[BEGINS * a + b] += all[a][b] - taken;
                    } else {
                        right[a] += all[a][BEGINS + HEAD] - taken;
                    }
                }
            }
        }
    }
}

// Of each sector of each ring of a frame, where it has `needed` points, the one of median radius, the first of equals:
// indices into points (n, 3), sector by sector of ring after ring; how many. ring (n,); ends (k,), of k sectors of all
// rings; sector (n,), laid (n,), radii (2, n): room.
DOOR int64_t middle_points(const float* const points, const uint8_t* const ring, const int64_t sectors,
                           const int64_t needed, int64_t* const ends, int64_t* const sector, int64_t* const laid,
                           double* const radii, int64_t* const chosen, const int64_t n, const int64_t k)
{
    if (sectors < 1 || k < 1) {
        return 0;
    }
    double *const radius = radii, *const some = radii + n;
    memset(ends, 0, (size_t)k * sizeof *ends);
    for (int64_t i = 0; i < n; i++) {
        const double x = (double)points[3 * i], y = (double)points[3 * i + 1];
        const double turn = arc_tangent(y, x) * SECTOR_OF_RAD;
        const int64_t at = whole(floor(turn * (double)sectors), -sectors, sectors);
        radius[i] = sqrt(x * x + y * y);
        sector[i] = bounded(ring[i] * sectors + (at + sectors) % sectors, 0, k - 1);
        ends[sector[i]]++;
    }
    int64_t begin = 0, count = 0;
    for (int64_t own = 0; own < k; own++) {  // where each begins, and as points are laid where it ends
        const int64_t size = ends[own];
        ends[own] = begin;
        begin += size;
    }
    for (int64_t i = 0; i < n; i++) {
        laid[ends[sector[i]]++] = i;
    }
    begin = 0;
    for (int64_t own = 0; own < k; own++) {
        const int64_t size = ends[own] - begin;
        if (size >= needed && size > 0) {
            for (int64_t i = 0; i < size; i++) {
                some[i] = radius[laid[begin + i]];
            }
            const double wanted = middle(some, size);
            int64_t before = size / 2;  // of its equals so many come first
            for (int64_t i = 0; i < size; i++) {
                before -= radius[laid[begin + i]] < wanted;
            }
            for (int64_t i = 0; i < size; i++) {
                if (radius[laid[begin + i]] == wanted && before-- == 0) {
                    chosen[count++] = laid[begin + i];
                    break;
                }
            }
        }
        begin = ends[own];
    }
    return count;
}
