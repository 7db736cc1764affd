/* Small steps of a soft body: weight and air, then every constraint once, then colliders. constraints.py is the definition
   of each; FORMULAS are generated from it. LANES bodies lie side by side, so that an element of all of them is one vector;
   for a single body, the elements of a colour are, which share no node. */

#include <stdlib.h>
#include <string.h>
#include <math.h>

typedef REAL real;
#define AXIS 1 /* of a formula's arguments, which are copied out of the arrays */
#define INLINE static inline __attribute__((always_inline))

FORMULAS

typedef struct {
    long nodes, pairs, pair_colours, tetrahedra, tetrahedron_colours, faces, face_colours, pins, movers, capsules, boxes, planes, muscles;
    const int *pair, *pair_colour, *tetrahedron, *tetrahedron_colour, *face, *face_colour;
    const int *pin, *holder, *capsule_mover, *box_mover, *plane_mover;
    const int *muscle; /* two of each pair */
    const real *lightness, *length, *compliance, *damping, *volume, *volume_compliance;
    const real *held; /* pins from their movers */
    const real *radius, *capsule_start, *capsule_along, *capsule_friction;
    const real *half, *box_centre, *box_friction;
    const real *normal, *plane_point, *plane_friction;
    const real *wind; /* axis by axis, a number for each lane */
    const real *surface; /* height of the water's, for each lane */
    const real *shortening; /* share of its length by which each of its two muscles shortens a pair */
    const real *lift; /* weight of the water a node displaces, over its own */
    double margin, drag, air, air_limit, gravity[3], face_drag, water_drag, depth, time_constant;
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

/* The corners of face e, two of its edges, and the mean velocity of its corners. */
#define FACE \
    const int i = b->face[3 * e], j = b->face[3 * e + 1], k = b->face[3 * e + 2]; \
    real right[3], up[3], flow[3], push[3]; \
    for (int a = 0; a < 3; a++) { \
        right[a] = AT(x, j, a) - AT(x, i, a); \
        up[a] = AT(x, k, a) - AT(x, i, a); \
        flow[a] = (AT(v, i, a) + AT(v, j, a) + AT(v, k, a)) / 3; \
    }
#define PUSH_FACE \
    for (int a = 0; a < 3; a++) { \
        AT(v, i, a) += h / 3 * b->lightness[i] * push[a]; \
        AT(v, j, a) += h / 3 * b->lightness[j] * push[a]; \
        AT(v, k, a) += h / 3 * b->lightness[k] * push[a]; \
    }

static void add_air(const Body *b, const real *restrict x, real *restrict v, real h) {
    const size_t count = b->nodes;
    COLOURS(b->face_colour, b->face_colours)
        FACE
        real wind[3];
        for (int a = 0; a < 3; a++) wind[a] = b->wind[a * LANES + l] - flow[a];
        air_push(right, up, wind, (real)b->air, (real)b->air_limit, push);
        PUSH_FACE
    END
}

static void add_water(const Body *b, const real *restrict x, real *restrict v, real h) {
    const size_t count = b->nodes;
    const real depth = (real)b->depth;
    const real gravity[3] = {b->gravity[0], b->gravity[1], b->gravity[2]};
    COLOURS(b->face_colour, b->face_colours)
        FACE
        const real height = (AT(x, i, 2) + AT(x, j, 2) + AT(x, k, 2)) / 3;
        water_push(right, up, flow, height, (real)b->face_drag, b->surface[l], depth, push);
        PUSH_FACE
    END
    ELEMENTS(0, b->nodes)
        const real before[3] = READ(v, e);
        real after[3];
        lifted(before, AT(x, e, 2), gravity, b->lift[e], (real)b->water_drag, b->surface[l], depth, h, after);
        for (int a = 0; a < 3; a++) AT(v, e, a) = after[a];
    END
}

static void coast(const Body *b, real *restrict x, real *restrict v, real *restrict p, real h) {
    const size_t count = b->nodes;
    const real gravity[3] = {b->gravity[0], b->gravity[1], b->gravity[2]};
    ELEMENTS(0, b->nodes)
        const real before[3] = READ(v, e);
        const real wind[3] = {b->wind[l], b->wind[LANES + l], b->wind[2 * LANES + l]};
        real after[3];
        fall(before, wind, gravity, (real)b->drag, h, after);
        const real is_free = b->lightness[e] > 0;
        for (int a = 0; a < 3; a++) {
            AT(p, e, a) = AT(x, e, a);
            AT(x, e, a) += is_free * h * after[a];
        }
    END
}

/* A mover's pose: its position, and its axes in the world, one after another. */
#define POSE(poses, mover, k) (poses)[(12 * (size_t)(mover) + (k)) * LANES + l]

/* Write the poses at a share of the way between two, on which movers turn evenly. */
static void pose_movers(const Body *b, const real *from, const real *to, double share, real *poses) {
    for (long m = 0; m < b->movers; m++)
        for (int l = 0; l < LANES; l++) {
            double q[4], cosine = 0;
            for (int k = 0; k < 7; k++) {
                const size_t entry = (7 * m + k) * LANES + l;
                if (k < 3) POSE(poses, m, k) = from[entry] + (real)share * (to[entry] - from[entry]);
                else cosine += (double)from[entry] * to[entry];
            }
            const double angle = acos(fmin(fabs(cosine), 1)), whole = sin(angle);
            const double first = whole > 1e-9 ? sin((1 - share) * angle) / whole : 1 - share;
            const double last = copysign(whole > 1e-9 ? sin(share * angle) / whole : share, cosine);
            double squares = 0;
            for (int k = 0; k < 4; k++) {
                const size_t entry = (7 * m + 3 + k) * LANES + l;
                q[k] = first * from[entry] + last * to[entry];
                squares += q[k] * q[k];
            }
            const double two = 2 / squares, w = q[0], x = q[1], y = q[2], z = q[3];
            const double axes[9] = {
                1 - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y),
                two * (x * y - w * z), 1 - two * (x * x + z * z), two * (y * z + w * x),
                two * (x * z + w * y), two * (y * z - w * x), 1 - two * (x * x + y * y),
            };
            for (int k = 0; k < 9; k++) POSE(poses, m, 3 + k) = (real)axes[k];
        }
}

INLINE void place(const real *poses, int mover, int l, const real *local, real *world) {
    for (int a = 0; a < 3; a++) {
        world[a] = POSE(poses, mover, a);
        for (int k = 0; k < 3; k++) world[a] += POSE(poses, mover, 3 + 3 * k + a) * local[k];
    }
}

static void hold_pins(const Body *b, real *restrict x, const real *poses) {
    const size_t count = b->nodes;
    for (long e = 0; e < b->pins; e++)
        for (int l = 0; l < LANES; l++) {
            real where[3];
            place(poses, b->holder[e], l, b->held + 3 * e, where);
            for (int a = 0; a < 3; a++) AT(x, b->pin[e], a) = where[a];
        }
}

static void pull_pairs(const Body *b, real *restrict x, const real *restrict p, const real *restrict active, real h) {
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
#if MUSCLES
        const real *share = b->shortening + 2 * e;
        const real first = active[b->muscle[2 * e] * LANES + l], second = active[b->muscle[2 * e + 1] * LANES + l];
        const real length = b->length[e] * (1 - share[0] * first - share[1] * second);
#else
        const real length = b->length[e];
#endif
        distance_push(extent, parting, light_i + light_j, length, softness, damping, push);
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

/* Axis k of a vector of each lane. */
#define OF(vector, k) (vector)[(k) * LANES + l]
#define TAKE(vector) {OF(vector, 0), OF(vector, 1), OF(vector, 2)}

/* Write the position of a point of a mover, and its displacement in this small step. */
static void follow(const real *before, const real *poses, int mover, const real *local, real *where, real *moved) {
    for (int l = 0; l < LANES; l++) {
        real last[3], now[3];
        place(before, mover, l, local, last);
        place(poses, mover, l, local, now);
        for (int a = 0; a < 3; a++) {
            OF(where, a) = now[a];
            OF(moved, a) = now[a] - last[a];
        }
    }
}

#define NODE \
    const real position[3] = READ(x, e); \
    const real moved[3] = {position[0] - AT(p, e, 0), position[1] - AT(p, e, 1), position[2] - AT(p, e, 2)}; \
    const real is_free = b->lightness[e] > 0; \
    real push[3];
#define PUSH for (int a = 0; a < 3; a++) AT(x, e, a) = position[a] + is_free * push[a];

static void collide(const Body *b, real *restrict x, const real *restrict p, const real *before, const real *poses) {
    const size_t count = b->nodes;
    real starts[3 * LANES], starts_moved[3 * LANES], ends[3 * LANES], ends_moved[3 * LANES];
    for (long c = 0; c < b->capsules; c++) {
        const real radius = b->radius[c] + (real)b->margin, friction = b->capsule_friction[c];
        const real *start_held = b->capsule_start + 3 * c, *along_held = b->capsule_along + 3 * c;
        const real end_held[3] = {start_held[0] + along_held[0], start_held[1] + along_held[1], start_held[2] + along_held[2]};
        follow(before, poses, b->capsule_mover[c], start_held, starts, starts_moved);
        follow(before, poses, b->capsule_mover[c], end_held, ends, ends_moved);
        ELEMENTS(0, b->nodes)
            NODE
            const real start[3] = TAKE(starts), start_moved[3] = TAKE(starts_moved);
            real along[3], along_moved[3];
            for (int a = 0; a < 3; a++) {
                along[a] = OF(ends, a) - start[a];
                along_moved[a] = OF(ends_moved, a) - start_moved[a];
            }
            capsule_push(position, moved, start, along, start_moved, along_moved, radius, friction, push);
            PUSH
        END
    }
    for (long c = 0; c < b->boxes; c++) {
        const int mover = b->box_mover[c];
        const real friction = b->box_friction[c];
        const real *axes = poses + (12 * (size_t)mover + 3) * LANES;
        real turns[3 * LANES];
        follow(before, poses, mover, b->box_centre + 3 * c, starts, starts_moved);
        for (int l = 0; l < LANES; l++)
            for (int a = 0; a < 3; a++) {
                const int i = 3 + (a + 1) % 3, j = 3 + (a + 2) % 3;
                real crossed = 0;
                for (int k = 0; k < 9; k += 3)
                    crossed += POSE(before, mover, i + k) * POSE(poses, mover, j + k) - POSE(before, mover, j + k) * POSE(poses, mover, i + k);
                OF(turns, a) = crossed / 2;
            }
        ELEMENTS(0, b->nodes)
            NODE
            const real centre[3] = TAKE(starts), centre_moved[3] = TAKE(starts_moved), turned[3] = TAKE(turns);
            const real ahead[3] = TAKE(axes), left[3] = TAKE(axes + 3 * LANES), up[3] = TAKE(axes + 6 * LANES);
            box_push(position, moved, centre, ahead, left, up, b->half + 3 * c, centre_moved, turned, (real)b->margin, friction, push);
            PUSH
        END
    }
    for (long c = 0; c < b->planes; c++) {
        follow(before, poses, b->plane_mover[c], b->plane_point + 3 * c, starts, starts_moved);
        ELEMENTS(0, b->nodes)
            NODE
            const real point[3] = TAKE(starts), point_moved[3] = TAKE(starts_moved);
            plane_push(position, moved, point, b->normal + 3 * c, point_moved, (real)b->margin, b->plane_friction[c], push);
            PUSH
        END
    }
}

static void settle(const Body *b, const real *restrict x, real *restrict v, const real *restrict p, real h) {
    const size_t count = b->nodes;
    const real inverse = 1 / h;
    for (size_t e = 0; e < 3 * count * LANES; e++) v[e] = (x[e] - p[e]) * inverse;
}

/* Write positions and velocities after each of `frames` frames of `steps` small steps of h seconds; 0, or 1 without memory.
   `paths` holds the movers' positions and quaternions, at the start and at each frame's end, `controls` those of the muscles in
   each frame, which their activations `active` follow. */
int play(
    const Body *b, long frames, long steps, double h, const real *start, const real *paths, const real *controls, real *active,
    real *states
) {
    const size_t size = 3 * b->nodes * LANES;
    const size_t stride = 7 * b->movers * LANES;
    const size_t of_poses = 12 * b->movers * LANES;
    real *x = malloc((3 * size + 2 * of_poses) * sizeof(real));
    if (!x) return 1;
    real *v = x + size, *p = v + size, *poses = p + size, *before = poses + of_poses;
    memcpy(x, start, 2 * size * sizeof(real));
    pose_movers(b, paths, paths, 0, poses);
    const real left = b->time_constant > 0 ? (real)exp(-h / b->time_constant) : 0;
    for (long frame = 0; frame < frames; frame++) {
        const real *held = controls + frame * b->muscles * LANES;
        const real *from = paths + frame * stride, *to = from + stride;
        for (long step = 0; step < steps; step++) {
            real *spare = before;
            before = poses;
            poses = spare;
            pose_movers(b, from, to, (step + 1) / (double)steps, poses);
            for (long k = 0; k < b->muscles * LANES; k++) active[k] = held[k] + left * (active[k] - held[k]);
            if (b->air > 0) add_air(b, x, v, (real)h);
            if (b->face_drag > 0) add_water(b, x, v, (real)h);
            coast(b, x, v, p, (real)h);
            hold_pins(b, x, poses);
            pull_pairs(b, x, p, active, (real)h);
            keep_volumes(b, x, (real)h);
            collide(b, x, p, before, poses);
            settle(b, x, v, p, (real)h);
        }
        memcpy(states + frame * 2 * size, x, 2 * size * sizeof(real));
    }
    free(x);
    return 0;
}
