/* Small steps of a soft body: weight and air, then every constraint once, then colliders. constraints.py is the definition
   of each; FORMULAS are generated from it. LANES bodies lie side by side, so that an element of all of them is one vector;
   of one body alone, the elements of a colour are, which share no node. */

#include <stdlib.h>
#include <string.h>
#include <math.h>

typedef REAL real;
#define AXIS 1 /* of the numbers a formula is given, which are copied out of the arrays */
#define INLINE static inline __attribute__((always_inline))

FORMULAS

typedef struct {
    long nodes, pairs, pair_colours, tetrahedra, tetrahedron_colours, faces, face_colours, pins, capsules, planes;
    const int *pair, *pair_colour, *tetrahedron, *tetrahedron_colour, *face, *face_colour, *pin;
    const real *lightness, *length, *compliance, *damping, *volume, *volume_compliance;
    const real *radius, *capsule_friction, *plane_friction, *normal; /* of capsules and planes */
    double margin, drag, air, air_limit, gravity[3], wind[3];
} Body;

/* Axis k of node i of lane l. */
#define AT(array, i, k) (array)[((size_t)(k) * count + (i)) * LANES + l]
#define READ(array, i) {AT(array, i, 0), AT(array, i, 1), AT(array, i, 2)}
#if LANES == 1
#define ELEMENTS(first, last) _Pragma("GCC ivdep") for (long e = first; e < last; e++) { const int l = 0;
#else
#define ELEMENTS(first, last) for (long e = first; e < last; e++) { _Pragma("GCC ivdep") for (int l = 0; l < LANES; l++) {
#endif
#if LANES == 1
#define END }
#else
#define END }}
#endif
#define COLOURS(starts, colours) for (long colour = 0; colour < colours; colour++) \
    ELEMENTS((starts)[colour], (starts)[colour + 1])

static void add_air(const Body *b, const real *restrict x, real *restrict v, real h) {
    const size_t count = b->nodes;
    COLOURS(b->face_colour, b->face_colours)
        const int i = b->face[3 * e], j = b->face[3 * e + 1], k = b->face[3 * e + 2];
        real right[3], up[3], wind[3], push[3];
        for (int a = 0; a < 3; a++) {
            right[a] = AT(x, j, a) - AT(x, i, a);
            up[a] = AT(x, k, a) - AT(x, i, a);
            wind[a] = (real)b->wind[a] - (AT(v, i, a) + AT(v, j, a) + AT(v, k, a)) / 3;
        }
        air_push(right, up, wind, (real)b->air, (real)b->air_limit, push);
        for (int a = 0; a < 3; a++) {
            AT(v, i, a) += h / 3 * b->lightness[i] * push[a];
            AT(v, j, a) += h / 3 * b->lightness[j] * push[a];
            AT(v, k, a) += h / 3 * b->lightness[k] * push[a];
        }
    END
}

static void coast(const Body *b, real *restrict x, real *restrict v, real *restrict p, real h) {
    const size_t count = b->nodes;
    const real gravity[3] = {b->gravity[0], b->gravity[1], b->gravity[2]};
    const real wind[3] = {b->wind[0], b->wind[1], b->wind[2]};
    ELEMENTS(0, b->nodes)
        const real before[3] = READ(v, e);
        real after[3];
        fall(before, wind, gravity, (real)b->drag, h, after);
        const real is_free = b->lightness[e] > 0;
        for (int a = 0; a < 3; a++) {
            AT(p, e, a) = AT(x, e, a);
            AT(x, e, a) += is_free * h * after[a];
        }
    END
}

static void hold_pins(const Body *b, real *restrict x, const real *from, const real *to, real share) {
    const size_t count = b->nodes;
    const size_t pins = b->pins;
    for (size_t e = 0; e < pins; e++)
        for (int a = 0; a < 3; a++)
            for (int l = 0; l < LANES; l++) {
                const size_t place = (3 * e + a) * LANES + l;
                AT(x, b->pin[e], a) = from[place] + share * (to[place] - from[place]);
            }
}

static void pull_pairs(const Body *b, real *restrict x, const real *restrict p, real h) {
    const size_t count = b->nodes;
    const real inverse = 1 / h;
    COLOURS(b->pair_colour, b->pair_colours)
        const int i = b->pair[2 * e], j = b->pair[2 * e + 1];
        real extent[3], parting[3], push[3];
        for (int a = 0; a < 3; a++) {
            extent[a] = AT(x, j, a) - AT(x, i, a);
            parting[a] = extent[a] - (AT(p, j, a) - AT(p, i, a));
        }
        const real softness = b->compliance[e] * inverse * inverse;
        const real damping = b->compliance[e] * b->damping[e] * inverse;
        const real light_i = b->lightness[i], light_j = b->lightness[j];
        distance_push(extent, parting, light_i + light_j, b->length[e], softness, damping, push);
        for (int a = 0; a < 3; a++) {
            AT(x, i, a) -= light_i * push[a];
            AT(x, j, a) += light_j * push[a];
        }
    END
}

static void keep_volumes(const Body *b, real *restrict x, real h) {
    const size_t count = b->nodes;
    COLOURS(b->tetrahedron_colour, b->tetrahedron_colours)
        const int *corner = b->tetrahedron + 4 * e;
        real edge[3][3], slope[4][3], light[4], squares = 0;
        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++) edge[k][a] = AT(x, corner[k + 1], a) - AT(x, corner[0], a);
        volume_slope(edge[1], edge[2], slope[1]);
        volume_slope(edge[2], edge[0], slope[2]);
        volume_slope(edge[0], edge[1], slope[3]);
        for (int a = 0; a < 3; a++) slope[0][a] = -(slope[1][a] + slope[2][a] + slope[3][a]);
        for (int k = 0; k < 4; k++) {
            light[k] = b->lightness[corner[k]];
            squares += light[k] * (slope[k][0] * slope[k][0] + slope[k][1] * slope[k][1] + slope[k][2] * slope[k][2]);
        }
        const real push = volume_push(edge[0], slope[1], squares, b->volume[e], b->volume_compliance[e] / (h * h));
        for (int k = 0; k < 4; k++)
            for (int a = 0; a < 3; a++) AT(x, corner[k], a) += light[k] * push * slope[k][a];
    END
}

/* A capsule is an axis' start and its extent; a plane is a point of it, and `normal` does not change. */
static void collide(const Body *b, real *restrict x, const real *restrict p, const real *from, const real *to, real share, real part) {
    const size_t count = b->nodes;
#define PLACE(offset) ((offset) + a) * LANES + l
    for (long c = 0; c < b->capsules; c++) {
        const size_t at = 6 * c;
        const real radius = b->radius[c] + (real)b->margin, friction = b->capsule_friction[c];
        ELEMENTS(0, b->nodes)
            real position[3], moved[3], start[3], along[3], start_moved[3], along_moved[3], push[3];
            for (int a = 0; a < 3; a++) {
                const real start_change = to[PLACE(at)] - from[PLACE(at)];
                const real along_change = to[PLACE(at + 3)] - from[PLACE(at + 3)];
                position[a] = AT(x, e, a);
                moved[a] = position[a] - AT(p, e, a);
                start[a] = from[PLACE(at)] + share * start_change;
                along[a] = from[PLACE(at + 3)] + share * along_change;
                start_moved[a] = part * start_change;
                along_moved[a] = part * along_change;
            }
            capsule_push(position, moved, start, along, start_moved, along_moved, radius, friction, push);
            const real is_free = b->lightness[e] > 0;
            for (int a = 0; a < 3; a++) AT(x, e, a) = position[a] + is_free * push[a];
        END
    }
    for (long c = 0; c < b->planes; c++) {
        const size_t at = 6 * b->capsules + 3 * c;
        ELEMENTS(0, b->nodes)
            real position[3], moved[3], point[3], point_moved[3], push[3];
            for (int a = 0; a < 3; a++) {
                const real change = to[PLACE(at)] - from[PLACE(at)];
                position[a] = AT(x, e, a);
                moved[a] = position[a] - AT(p, e, a);
                point[a] = from[PLACE(at)] + share * change;
                point_moved[a] = part * change;
            }
            plane_push(position, moved, point, b->normal + 3 * c, point_moved, (real)b->margin, b->plane_friction[c], push);
            const real is_free = b->lightness[e] > 0;
            for (int a = 0; a < 3; a++) AT(x, e, a) = position[a] + is_free * push[a];
        END
    }
}

static void settle(const Body *b, const real *restrict x, real *restrict v, const real *restrict p, real h) {
    const size_t count = b->nodes;
    const real inverse = 1 / h;
    for (size_t e = 0; e < 3 * count * LANES; e++) v[e] = (x[e] - p[e]) * inverse;
}

/* Write positions and velocities after each of `frames` frames of `steps` small steps of h seconds; 0, or 1 without memory.
   `paths` holds, for the start and for each frame's end, where pins are, and then colliders. */
int play(const Body *b, long frames, long steps, double h, const real *start, const real *paths, real *states) {
    const size_t size = 3 * b->nodes * LANES;
    const size_t pins = 3 * b->pins * LANES;
    const size_t stride = pins + (6 * b->capsules + 3 * b->planes) * LANES;
    real *x = malloc(3 * size * sizeof(real));
    if (!x) return 1;
    real *v = x + size, *p = v + size;
    memcpy(x, start, 2 * size * sizeof(real));
    for (long frame = 0; frame < frames; frame++) {
        const real *from = paths + frame * stride, *to = from + stride;
        for (long step = 0; step < steps; step++) {
            const real share = (step + 1) / (real)steps;
            if (b->air > 0) add_air(b, x, v, (real)h);
            coast(b, x, v, p, (real)h);
            hold_pins(b, x, from, to, share);
            pull_pairs(b, x, p, (real)h);
            keep_volumes(b, x, (real)h);
            collide(b, x, p, from + pins, to + pins, share, 1 / (real)steps);
            settle(b, x, v, p, (real)h);
        }
        memcpy(states + frame * 2 * size, x, 2 * size * sizeof(real));
    }
    free(x);
    return 0;
}
